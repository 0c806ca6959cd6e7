"""What appendages do to a robot: exact motions without water, one drag in fluid and twin."""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, glide, moving, servos

from sim.inference.calibration import calibrate
from sim.inference.coordinates import appendage_parameters, candidates
from sim.inference.swims import Swim, by_twin, simulated, with_values
from sim.lattice.velocities import WATER_KG_M3 as WATER
from sim.robot.shape import displaced, draught, hull_of, submerged
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.law import Coefficients
from sim.twin.twin import Twin
from sim2real.appendages import Appendage
from sim2real.errors import InputError
from sim2real.model import JointModel, Model
from sim2real.ranges.sources import body_ranges

NO_WATER = Coefficients(across=0.0, along=0.0, added_mass=0.0, thrust=0.0)
"""A law without forces."""
RIGID = JointModel(1e5, 500.0, 0.0, 0.0)
STIFF = Model(joints={joint.name: RIGID for joint in FISH.joints}, body={"twin": vars(NO_WATER)})
BOX = Appendage("box", "box", (0.10, 0.06, 0.05), (0.05, 0.04, 0.0), submerged=1.0)


def carrying(appendage, link=0):
    """The fish with an appendage on one link."""
    links = list(FISH.links)
    links[link] = replace(links[link], appendages=(appendage,))
    return replace(FISH, links=tuple(links))


def glided(robot, model, seconds, velocity):
    """Path of the straight twin that starts with a velocity and no water's force, with rates."""
    twin = Twin(robot, model, substeps=20)
    twin.reset(pose=np.zeros(3))
    twin.adopt(np.array([0]), [model])
    moving(twin, [[*velocity, 0.0, 0.0, 0.0]])
    states = [twin.state()]
    for _ in range(round(seconds / CONTROL_S)):
        twin.step(np.zeros(3))
        states.append(twin.state())
    return twin, states


def test_a_box_slows_a_glide_as_the_formula_says():
    """du / dt = - A rho / 2 (M + m) u^2, so u = u0 / (1 + A rho u0 t / 2 (M + m))."""
    box = replace(BOX, at_m=(0.05, 0.0, 0.0), drag=(0.9, 0.1))
    robot = carrying(box)
    twin, states = glided(robot, STIFF, 1.0, (0.4, 0.0, 0.0))
    wetted = box.wetted(twin.surface_m)
    mass = sum(link.mass_kg for link in FISH.links) + WATER * wetted.added_mass_m3[0]
    drag = 0.5 * WATER * wetted.area_m2[0] * 0.4 / mass
    speeds = [state.velocity[0, 0] for state in states]
    assert wetted.area_m2[0] == pytest.approx(0.9 * 0.06 * 0.05)
    assert speeds[-1] == pytest.approx(0.4 / (1 + drag), rel=2e-3)
    more = with_values(STIFF, {"appendage_area.ratio": 1.0})
    faster = glided(robot, more, 1.0, (0.4, 0.0, 0.0))[1][-1].velocity[0, 0]
    assert faster == pytest.approx(0.4 / (1 + 2 * drag), rel=2e-3)


def test_added_mass_keeps_momentum_and_energy():
    """A box off the axis turns with the body: Kirchhoff's equations, without drag."""
    box = replace(BOX, drag=(0.0, 0.0), lateral_drag=(0.0, 0.0))
    twin, states = glided(carrying(box), STIFF, 2.0, (0.3, 0.1, 1.5))
    laden = twin.chain.laden.numpy()[0, 0]
    assert laden[1, 1] > 1.2 * laden[0, 0] > 0
    mass = twin.chain.mass.numpy()[0]

    def of(state):
        c, s = np.cos(state.pose[0, 2]), np.sin(state.pose[0, 2])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        return turn, state.velocity[0]

    energy, momenta = [], []
    com = twin.chain.com.numpy()[0]
    behind = np.cumsum([0.0, *twin.hull.length[:-1]])
    ahead = com[0] - behind - com
    for state in states:
        turn, v = of(state)
        inertia = laden.copy()
        for (m, own), x in zip(mass, ahead, strict=True):
            row = np.array([0.0, 1.0, x])
            inertia += m * (np.outer([1, 0, 0], [1, 0, 0]) + np.outer(row, row))
            inertia[2, 2] += own
        energy.append(0.5 * v @ inertia @ v)
        momenta.append(turn @ inertia @ v)
    momenta = np.array(momenta)
    assert momenta[-1, :2] == pytest.approx(momenta[0, :2], rel=0.01)
    assert energy[-1] == pytest.approx(energy[0], rel=0.01)
    yaw = np.array([state.velocity[0, 2] for state in states])
    assert np.ptp(yaw) > 0.02  # the moment of Munk is there


def test_drag_off_the_axis_turns_the_robot():
    left, right = (
        glided(carrying(replace(BOX, at_m=(0.05, y, 0.0))), STIFF, 0.5, (0.4, 0.0, 0.0))[1]
        for y in (0.05, -0.05)
    )
    assert left[-1].velocity[0, 2] > 0.05
    assert right[-1].velocity[0, 2] == pytest.approx(-left[-1].velocity[0, 2])


def test_area_that_the_file_lacks_is_where_it_is_said_to_be():
    """The same drag as an appendage of equal areas, on the link on which the place is."""
    where = FISH.links[0].length_m + 0.03
    lacking = {"appendage_drag.area_m2": 0.003, "appendage_drag.x_m": where}
    twin = Twin(FISH, with_values(STIFF, lacking))
    point = twin.chain.point.numpy()[0]
    assert np.count_nonzero(point[:, :, 2]) == 1
    assert point[1, -1] == pytest.approx(
        [twin.chain.com.numpy()[0, 1] - 0.03, 0, *2 * [WATER * 0.0015]]
    )


def test_the_fluid_has_the_drag_of_the_twin():
    """On the head of a straight robot an area resists as the form drag of the same area."""
    hull = hull_of(FISH)
    frontal = np.pi * float((hull.half_width * hull.half_height).max())
    plain, form = glide(15), glide(15, form_drag__coefficient=1.0)
    area = glide(15, appendage_drag__area_m2=frontal, appendage_drag__x_m=0.1)
    assert area == pytest.approx(form, abs=0.02 * (plain - form))
    assert plain - form > 0.01


def test_a_box_carries_a_part_of_the_weight():
    hull, mass = hull_of(FISH), sum(link.mass_kg for link in FISH.links)
    box = Appendage("float", "box", (0.1, 0.1, 0.04), (0.1, 0.0, 0.0))
    alone, helped = draught(hull, mass), draught(hull, mass, (box,))
    assert helped < alone
    own = displaced(hull, hull.body_length / 60, 0.0, False, helped)[:, 0].sum()
    assert WATER * (own + box.displaced_m3(helped)) == pytest.approx(mass, rel=2e-3)
    huge = replace(box, size_m=(1.0, 1.0, 1.0))
    with pytest.raises(InputError, match="appendages that displace 998 kg"):
        Swimmer(carrying(huge), servos(), dimensions=2, cell_m=0.04, box_m=(0.9, 0.9, 0.4))


@pytest.mark.parametrize("size", ["width_m", "height_m", "length_m"])
@pytest.mark.parametrize("value", [1e-6, 10.0, 1e5])
def test_links_of_any_size_are_measured_on_a_grid_of_bounded_size(size, value):
    head, *others = FISH.links
    fish = replace(FISH, links=(replace(head, **{size: value}), *others))
    hull, _, above = submerged(fish, False, np.inf)
    assert np.isfinite(hull.half_height).all()
    assert above > -hull.extent


def test_a_robot_lighter_than_what_is_always_under_water_is_refused():
    keel = Appendage("keel", "box", (0.1, 0.1, 0.04), (0.1, 0.0, 0.0), submerged=1.0)
    with pytest.raises(InputError, match=r"displace 0.399 kg of water.* robot's 0.01 kg"):
        draught(hull_of(FISH), 0.01, (keel,))


def test_a_calibration_fits_the_areas_and_a_diagnosis_does_not():
    robot = carrying(replace(BOX, drag=(1.0, 0.25)))
    (ratio,) = appendage_parameters(robot)
    assert (ratio.name, ratio.nominal) == ("appendage_area.ratio", 0.0)
    assert ratio.prior_sd == pytest.approx(0.25)
    assert appendage_parameters(FISH) == []
    names = {name for name, _ in candidates(robot)}
    assert "appendage_drag" in names
    assert "appendage_area" not in names


def test_the_error_of_the_areas_is_fitted_and_reaches_the_ranges():
    robot = carrying(replace(BOX, drag=(1.0, 0.3)))
    plain = replace(servos(), body={})
    t = 0.02 * np.arange(200)
    command = 0.4 * np.sin(2 * np.pi * 1.2 * t[:, None] - np.array([0.0, 1.0, 2.0]))
    blank = Swim("made", t, command, np.zeros(3), np.empty((t.size, 0)), np.zeros((t.size, 3)))
    simulator = by_twin(robot, threads=1)
    truth = with_values(plain, {"appendage_area.ratio": 0.4})
    (seen,) = simulated(blank, [truth], simulator)
    seen[:, :3] += np.random.default_rng(3).normal(0, [0.005, 0.005, 0.03], (t.size, 3))
    swim = replace(blank, signals=seen)
    fit = calibrate([swim], plain, appendage_parameters(robot), simulator)
    assert fit.best[0] == pytest.approx(0.4, abs=0.1)
    (low, high) = fit.interval()[0]
    assert low < 0.4 < high
    interval = {"appendage_area.ratio": [float(low), float(high)]}
    (drawn,) = body_ranges(replace(fit.model, body={**fit.model.body, "interval": interval}))
    assert (drawn.parameter, drawn.first) == ("body.appendage_area.ratio", pytest.approx(low))
