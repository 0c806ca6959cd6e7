"""The reduced-order twin: the swimmer's interface, a force law for its water."""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, beat, glide, in_a_box, moving, servos, with_effects

from sim.robot.swimmer import CONTROL_S
from sim.twin.law import FITTED, Coefficients
from sim.twin.twin import Twin
from sim2real.body import listed, values
from sim2real.errors import InputError

DRY = Coefficients(0.0, 0.0, 0.0, 0.0, 0.0)


def twins(*laws, model=None):
    """A twin of each law."""
    models = [replace(model or servos(), body={"twin": vars(law)}) for law in laws]
    return Twin(FISH, models, n_envs=len(laws))


def wave(t, scale=1.0):
    return scale * np.array([0.3, 0.45, 0.6]) * np.sin(2 * np.pi * t - 1.2 * np.arange(3))


def signal(seconds, scale=1.0, sign=1.0):
    times = CONTROL_S * np.arange(round(seconds / CONTROL_S))
    return np.array([sign * min(1.0, t) * wave(t, scale) for t in times])


def test_steps_and_a_whole_swim_are_the_same():
    sent = signal(1.0)
    one, other = Twin(FISH, servos(), n_envs=2), Twin(FISH, servos(), n_envs=2)
    track = one.swim(sent)
    for command in sent:
        other.step(command)
    assert np.array_equal(track[:, -1, :3], other.state().pose)
    assert np.array_equal(track[:, -1, 3:], other.state().measured)


def test_it_swims_head_first_and_its_mirror_image_mirrors():
    twin = Twin(FISH, servos(), n_envs=2)
    both = np.array([signal(6.0), signal(6.0, sign=-1.0)])
    track = twin.swim(both, np.arange(2))
    assert (track[:, -1, 0] - track[:, 0, 0] > 0.2).all()
    assert track[0, :, 1] == pytest.approx(-track[1, :, 1], abs=1e-9)
    assert track[0, :, 2] == pytest.approx(-track[1, :, 2], abs=1e-9)


def test_halving_the_step_changes_little():
    ends = []
    for substeps in (8, 16):
        twin = Twin(FISH, servos(), substeps=substeps)
        track = twin.swim(signal(8.0))
        ends.append(track[0, -1, 0] - track[0, 0, 0])
    assert ends[0] == pytest.approx(ends[1], rel=0.01)


def test_without_water_momentum_stays():
    twin = twins(DRY)
    start = twin.chain.mass.numpy()[0, :, :1] * twin.motion.link.numpy()[0, :, :2]
    twin.swim(signal(2.0))
    end = twin.chain.mass.numpy()[0, :, :1] * twin.motion.link.numpy()[0, :, :2]
    assert start.sum(axis=0) == pytest.approx(end.sum(axis=0), abs=1e-9)
    spin = twin.motion.twist.numpy()[0]
    at, mass = twin.motion.link.numpy()[0], twin.chain.mass.numpy()[0]
    total = mass[:, 1] * spin[:, 2] + mass[:, 0] * (at[:, 0] * spin[:, 1] - at[:, 1] * spin[:, 0])
    assert abs(total.sum()) < 1e-5


def test_water_only_takes_energy_from_slack_joints():
    slack = servos(kp=1e-9, kd=0.0)
    twin = twins(Coefficients(5.0, 5.0, 0.5, 0.0, 0.5), model=slack)
    moving(twin, [[0.3, 0.1, 1.0, 2.0, -2.0, 1.0]])
    energy = []
    for _ in range(50):
        mass, V = twin.chain.mass.numpy()[0], twin.motion.twist.numpy()[0]
        P = twin.water.carried.numpy()[0]
        own = mass[:, 0] * (V[:, 0] ** 2 + V[:, 1] ** 2) + mass[:, 1] * V[:, 2] ** 2
        energy.append(0.5 * float(own.sum() + (P * V).sum()))
        twin.step(np.zeros(3))
    assert energy[-1] < 0.8 * energy[0]
    assert (np.diff(energy) < 1e-4 * energy[0]).all()


def test_a_minute_of_hard_commands_does_not_blow_up():
    rng = np.random.default_rng(3)
    models = []
    for k, s in zip(rng.uniform(0.5, 6, 8), rng.uniform(0, 2, 8), strict=True):
        skin = listed({"skin_elasticity.stiffness_Nm_per_rad": float(s)})
        law = vars(Coefficients(*np.exp(rng.normal(0, 1, 3)), 0.2, 1.0))
        models.append(replace(servos(kp=k, kd=0.02 * k), body={"effects": skin, "twin": law}))
    twin = Twin(FISH, models, n_envs=8)
    sent = 0.8 * np.sign(rng.standard_normal((600, 3))).repeat(5, axis=0)
    track = twin.swim(sent)
    assert np.isfinite(track).all()
    assert np.abs(np.diff(track[..., :2], axis=1)).max() < 0.1


def test_a_wall_effect_drives_harder_near_a_wall():
    body = {"twin": vars(Coefficients(1.5, 1.0, 1.0, 1.0, 0.0))}
    near = body | {"effects": listed({"wall_effect.ratio": 1.0})}
    twin = Twin(FISH, [replace(servos(), body=one) for one in (body, near)], n_envs=2)
    twin.reset(pose=np.tile([0.0, 1.5, 0.0], (2, 1)))
    track = twin.swim(signal(4.0))
    assert track[1, -1, 0] > 1.02 * track[0, -1, 0]


def test_a_body_of_another_robot_is_refused():
    model = servos()
    with pytest.raises(InputError, match=r"body\.normalised_density: found 2 values, expected"):
        Twin(FISH, [replace(model, body={"normalised_density": [1.0, 1.0]})])
    with pytest.raises(InputError, match=r"body\.twin\.accross: found an unknown key.*across"):
        Coefficients.of({"twin": {"accross": 1.0}})


def test_a_law_of_the_first_five_names_stays_what_it_was():
    first = {"across": 3.0, "along": 0.5, "added_mass": 0.8, "thrust": 0.7, "linear": 0.5}
    old = Coefficients.of({"twin": first})
    assert old == Coefficients(**first)
    assert (old.slender, old.head, old.tail) == (1.0, 1.0, 1.0)
    assert (old.axial, old.wake, old.lag) == (0.0, 0.0, 0.0)
    assert Coefficients.of({"twin": {"across": 3.0}}) == replace(FITTED, across=3.0)
    assert Coefficients.of({}) == FITTED
    assert Coefficients.of({"twin": vars(FITTED)}) == FITTED


def test_the_water_goes_along_and_a_robot_glides_farther():
    straight = np.zeros((100, 3))
    laws = [Coefficients(1.5, 1.0, 1.0, 0.0, 1.0, wake=x, wake_s=0.5) for x in (0.0, 0.6)]
    still = twins(*laws)
    moving(still, 2 * [[0.3, 0, 0, 0, 0, 0]])
    track = still.swim(straight)
    gone = track[:, -1, 0] - track[:, 0, 0]
    assert gone[1] > 1.1 * gone[0]
    assert track[:, :, 1] == pytest.approx(0, abs=1e-12)
    moved = still.water.moved.numpy()
    assert np.all(moved[0] == 0) and np.all(moved[1, :, 0] > 0)
    still.reset()
    assert np.all(still.water.moved.numpy() == 0)


def test_an_added_mass_along_the_body_takes_its_share_of_a_push():
    heavy = Coefficients(0.0, 0.0, 0.0, 0.0, 0.0, axial=1.0)
    twin = twins(DRY, heavy)
    push = np.zeros((2, 6))
    push[:, 0] = 0.1
    twin.chain.push.assign(push)
    twin.swim(np.zeros((50, 3)))
    speed = twin.motion.v.numpy()[:, 0]
    mass = sum(link.mass_kg for link in FISH.links)
    carried = twin.water.axial.numpy()[1].sum()
    assert speed[0] / speed[1] == pytest.approx(1 + carried / mass, rel=1e-6)
    assert carried == pytest.approx(mass, rel=0.15)  # it floats: it displaces its own mass


def test_drag_that_lags_by_nothing_is_drag_that_does_not_lag():
    base = Coefficients(4.0, 1.0, 1.0, 0.3, 1.0)
    laws = [replace(base, lag=lag) for lag in (0.0, 1e-9, 1.0)]
    track = twins(*laws).swim(signal(3.0))
    assert track[1] == pytest.approx(track[0], abs=1e-9)
    assert np.abs(track[2] - track[0]).max() > 1e-3


def test_added_mass_and_drag_are_shared_as_the_law_says():
    water = twins(Coefficients(), Coefficients(head=0.5, tail=2.0)).water
    added, broad = water.added.numpy(), water.broad.numpy()
    assert added[1] / added[0] == pytest.approx(np.array([0.5, 1, 1, 1])[:, None].repeat(3, 1))
    assert broad[1] / broad[0] == pytest.approx(np.array([1, 1, 1, 2.0])[:, None].repeat(3, 1))


def swim(periods, wave=1.0, **parameters):
    swimmer = in_a_box(with_effects(**parameters))
    beat(swimmer, periods, wave)
    return swimmer.state()


def test_names_go_there_and_back():
    given = {
        "skin_elasticity.stiffness_Nm_per_rad": 0.2,
        "surface_friction.rubber.coefficient": 0.01,
        "surface_friction.abs.coefficient": 0.02,
    }
    model = replace(servos(), body={"effects": listed(given)})
    assert values(model) == given
    with pytest.raises(InputError, match="one of skin_elasticity"):
        values(replace(servos(), body={"effects": [{"effect": "magic", "parameters": {}}]}))
    with pytest.raises(InputError, match="no such parameter"):
        values(replace(servos(), body={"effects": [{"effect": "tether", "parameters": {"k": 1}}]}))


def test_a_stiff_skin_holds_the_joints_straight():
    free, stiff = swim(20), swim(20, skin_elasticity__stiffness_Nm_per_rad=10.0)
    assert np.abs(stiff.joint).max() < 0.5 * np.abs(free.joint).max()


def held(periods, command, **parameters):
    """Angle of the first joint after commands that do not change."""
    swimmer = in_a_box(with_effects(**parameters))
    for _ in range(periods):
        swimmer.step(np.array(command))
    return swimmer.state().joint[0, 0]


def test_a_skin_that_relaxes_gives_way():
    assert np.abs(swim(60, wave=0.0).joint).max() < 1e-9
    skin = "skin_viscoelasticity__stiffness_Nm_per_rad", "skin_viscoelasticity__relaxation_s"
    quick, slow = (
        held(40, [0.3] * 3, **dict(zip(skin, (3.0, relaxation), strict=True)))
        for relaxation in (0.02, 5.0)
    )
    assert slow < 0.75 * quick


def test_water_that_goes_along_slows_the_joints():
    alone, laden = (held(5, [0.6, 0.0, 0.0], added_mass__ratio=ratio) for ratio in (0.0, 2.0))
    assert 0 < laden < 0.95 * alone


def test_a_tether_pulls_to_its_anchor():
    given = {"tether__stiffness_N_per_m": 2.0, "tether__x_m": 0.1, "tether__y_m": 1.0}
    moved = swim(30, wave=0.0, **given).pose[0] - swim(30, wave=0.0).pose[0]
    assert moved[1] > 0.05


def test_a_current_carries_the_robot_along():
    still = swim(50, wave=0.0)
    drifting = swim(50, wave=0.0, pool_current__u_m_s=0.05, pool_current__v_m_s=0.02)
    assert drifting.pose[0, :2] - still.pose[0, :2] == pytest.approx([0.05, 0.02], abs=1e-3)
    assert drifting.velocity[0, :2] == pytest.approx([0.05, 0.02], abs=5e-3)


def test_trim_turns_the_joints_but_not_what_they_show():
    state = swim(60, wave=0.0, trim_asymmetry__offset_rad=0.1)
    assert state.joint[0] == pytest.approx([0.1] * 3, abs=0.01)
    assert state.measured[0] == pytest.approx([0.0] * 3, abs=0.01)


def test_drag_slows_a_robot_that_glides():
    plain = glide()
    assert 0.05 < plain < 0.3
    assert glide(linear_drag__coefficient=2.0) < 0.8 * plain
    assert glide(form_drag__coefficient=1.0) < 0.95 * plain
    assert glide(form_drag__coefficient=-0.2) > 1.01 * plain
    names = {link.material for link in FISH.links}
    rough = {f"surface_friction__{name or ''}__coefficient": 0.1 for name in names}
    assert glide(**rough) < 0.95 * plain


def test_a_mass_to_the_left_is_pushed_to_the_right():
    swimmer = in_a_box(with_effects(com_offset__y_m=0.03), cell_m=0.02)
    head = swimmer.state().pose[0]
    assert head[1] == pytest.approx(0.0, abs=1e-12)  # coordinates are those of the mass
    swimmer.bodies.push(np.array([[0.3, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    for _ in range(20):
        swimmer.step(np.zeros(3))
    assert swimmer.state().pose[0, 2] < -1e-3
