"""Bodies in the fluid: what must be conserved, what must be equal, what is known exactly."""

import numpy as np
import pytest

from sim.bodies import HELD, KINEMATIC, Bodies, Masses
from sim.cases import driven_cylinder
from sim.cases.swimming import Gait, swim
from sim.fluid import Fluid
from sim.lattice import D2Q9, D3Q19
from sim.shape import Hull, displaced
from sim.units import Units
from sim2real.servo.parameters import COLUMNS

LENGTH = 26.0
"""Body length in cells; units are those of the lattice."""


def fish(fluid, *, servo=(), limits=None, **more):
    """Four links at density ratio 1, straight, in the middle of each box."""
    r = np.array([0.085, 0.115, 0.06, 0.025, 0.02]) * LENGTH
    half = np.stack([r[:-1], (r[:-1] + r[1:]) / 2, r[1:]], axis=1)
    hull = Hull(np.full(4, (LENGTH - r[0] - r[-1]) / 4), half, half)
    true = displaced(hull, 1.0, 0.0, True)
    rows = np.zeros((3, len(COLUMNS)))
    for name, value in servo:
        rows[:, COLUMNS.index(name)] = value
    masses = Masses(true[:, 0], true[:, 2], true[:, 1])
    units = Units(1.0, 1.0, 1.0, 1.0)
    bodies = Bodies(fluid, hull, masses, units, servos=rows, limits=limits, **more)
    start = np.zeros((fluid.boxes, 6))
    start[:, :2] = fluid.size[0] // 2
    bodies.place(start)
    return bodies


def water(side=80, boxes=1, **more):
    return Fluid(D2Q9, (side, side), viscosity=0.02, smagorinsky=0.1, boxes=boxes, **more)


def send(bodies, angles):
    """Set-points in force from the start, shape (3,) or (E, 3)."""
    sent = bodies.motion.sent.numpy()
    sent[:, :, 0] = angles
    bodies.motion.sent.assign(sent)
    bodies.motion.newest.fill_(0)


STIFF = (("kp_Nm_per_rad", 4.0), ("kd_Nms_per_rad", 400.0))


def test_momentum_of_body_and_water_is_conserved():
    fluid = water(160)
    bodies = fish(fluid, servo=STIFF)
    send(bodies, [0.4, -0.5, 0.6])
    x, y = np.meshgrid(np.arange(160.0), np.arange(160.0), indexing="ij")
    impulse = 0.0
    for _ in range(200):
        bodies.step()
        impulse += np.abs(bodies.motion.force.numpy()[..., :2]).sum()
    rho, u = (field[0, :, :, 0].astype(np.float64) for field in fluid.moments())
    m = rho[..., None] * u
    held = np.array([m[..., 0].sum(), m[..., 1].sum(), (x * m[..., 1] - y * m[..., 0]).sum()])
    left = (held + bodies.momentum()[0]) / impulse
    assert np.abs(bodies.motion.q.numpy()[0, 3:]).max() > 0.1
    assert np.abs(left[:2]).max() < 1e-6
    assert np.abs(left[2]) < 1e-5 * LENGTH


def test_a_driven_cylinder_moves_as_stokes_says():
    figure = driven_cylinder.run(quick=True).figures[0]
    assert figure.met, figure


@pytest.mark.parametrize("lattice", [D2Q9, D3Q19])
def test_a_disc_and_a_ball_displace_what_they_should(lattice):
    flat = lattice is D2Q9
    hull = Hull(np.zeros(1), np.full((1, 3), 6.0), np.full((1, 3), 6.0))
    volume, centre, second = displaced(hull, 1.0, 0.0, flat)[0]
    exact = (np.pi * 36, np.pi * 6**4 / 2) if flat else (4 / 3 * np.pi * 216, 8 / 15 * np.pi * 6**5)
    assert volume == pytest.approx(exact[0], rel=0.02)
    assert second == pytest.approx(exact[1], rel=0.04)
    assert centre == pytest.approx(0.0, abs=1e-9)


def test_the_sums_over_a_body_are_those_of_what_it_displaces():
    fluid = water()
    bodies = fish(fluid)
    bodies.prescribe(np.zeros(6))
    bodies.step(HELD)
    flags = fluid.flags.numpy() & 64
    share = (fluid.solid.numpy() % 1)[flags > 0]
    assert share.sum() == pytest.approx(bodies.displaced[:, 0].sum(), rel=0.03)


def test_nothing_moves_by_itself():
    bodies = fish(water(), servo=STIFF)
    send(bodies, [0.0, 0.0, 0.0])
    start = bodies.motion.q.numpy()
    for _ in range(50):
        bodies.step()
    assert np.abs(bodies.motion.q.numpy() - start).max() < 1e-6


def test_prescribed_joints_turn_as_prescribed():
    bodies = fish(water())
    bodies.prescribe([0, 0, 0, 0.001, -0.002, 0.003])
    for _ in range(40):
        bodies.step(KINEMATIC)
    assert bodies.motion.q.numpy()[0, 3:] == pytest.approx([0.04, -0.08, 0.12])
    assert np.abs(bodies.motion.q.numpy()[0, :3] - [40, 40, 0]).max() > 1e-3


def test_servos_reach_their_set_points():
    bodies = fish(water(), servo=STIFF)
    send(bodies, [0.2, -0.3, 0.1])
    for _ in range(900):
        bodies.step()
    assert bodies.motion.q.numpy()[0, 3:] == pytest.approx([0.2, -0.3, 0.1], abs=0.02)


def test_a_set_point_that_is_late_moves_nothing_before():
    bodies = fish(water(), servo=STIFF)
    send(bodies, [0.3, 0.3, 0.3])
    bodies.motion.arrival.fill_(30.5)
    for _ in range(30):
        bodies.step()
    assert np.abs(bodies.motion.q.numpy()[0, 3:]).max() < 1e-6
    for _ in range(10):
        bodies.step()
    assert np.abs(bodies.motion.q.numpy()[0, 3:]).min() > 1e-5


def test_joints_stay_within_their_limits():
    bodies = fish(water(), servo=STIFF, limits=np.tile([-0.1, 0.1], (3, 1)))
    send(bodies, [0.2, -0.2, 0.2])
    for _ in range(900):
        bodies.step()
        assert np.abs(bodies.motion.q.numpy()[0, 3:]).max() < 0.1 + 1e-9
    assert bodies.motion.q.numpy()[0, 3:] == pytest.approx([0.1, -0.1, 0.1], abs=1e-6)
    assert bodies.fluid.stopped.numpy()[0] == -1


def test_dry_friction_stops_a_joint_short():
    still = fish(water(), servo=(*STIFF, ("coulomb_friction.torque_Nm", 0.4)))
    send(still, [0.08, -0.08, 0.08])
    moved = fish(water(), servo=(*STIFF, ("coulomb_friction.torque_Nm", 0.2)))
    send(moved, [0.2, -0.2, 0.2])
    for bodies in (still, moved):
        for _ in range(600):
            bodies.step()
    assert np.abs(still.motion.q.numpy()[0, 3:]).max() < 1e-9
    short = 0.2 - np.abs(moved.motion.q.numpy()[0, 3:])
    assert np.all(short > 0.02) and np.all(short < 0.06)


def test_boxes_of_a_batch_are_as_if_alone():
    viscosity, angles = np.array([0.01, 0.05]), np.array([[0.3, 0.3, 0.3], [-0.2, 0.1, 0.4]])
    together = fish(Fluid(D2Q9, (64, 64), viscosity=viscosity, boxes=2), servo=STIFF)
    send(together, angles)
    alone = [fish(Fluid(D2Q9, (64, 64), viscosity=v), servo=STIFF) for v in viscosity]
    for one, angle in zip(alone, angles, strict=True):
        send(one, angle)
    for bodies in (together, *alone):
        for _ in range(60):
            bodies.step()
    both = together.motion.q.numpy()
    assert np.array_equal(both, np.concatenate([one.motion.q.numpy() for one in alone]))
    assert not np.array_equal(both[0, 3:], both[1, 3:])


def test_the_mirror_image_swims_the_mirrored_way():
    here, there = Gait(turn=0.1), Gait(turn=0.1, side=-1.0)
    path = swim([here, there], 20, cycles=2).path
    assert np.abs(path[-1, 0] - path[0, 0]).max() > 0.05
    assert path[-1, 1, 0] == pytest.approx(path[-1, 0, 0], abs=0.01)
    offset = path[0, 0, 1]
    assert path[-1, 1, 1] - offset == pytest.approx(offset - path[-1, 0, 1], abs=0.01)
    assert path[-1, 1, 2] == pytest.approx(-path[-1, 0, 2], abs=0.02)


def test_a_wave_swims_head_first_and_its_reverse_hardly():
    swum = swim([Gait(), Gait(wave=-1.0), Gait(wave=0.0, amplitude=(0.6, 0.6, 0.6))], 26, cycles=4)
    forward, reverse, _ = swum.advance()
    assert forward > 0.08
    assert reverse < forward / 2
