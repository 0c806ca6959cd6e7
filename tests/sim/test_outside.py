"""What acts on a robot beside the water: skin, drag, mass, tether, current, trim."""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos

from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.body import listed, values
from sim2real.errors import InputError

BOX = (0.9, 0.9, 0.4)


def with_effects(**parameters):
    """A robot whose body has these effects; double underscores stand for dots."""
    named = {name.replace("__", "."): value for name, value in parameters.items()}
    return replace(servos(), body={"effects": listed(named)})


def swim(periods, n_envs=1, wave=1.0, **parameters):
    swimmer = Swimmer(
        FISH, with_effects(**parameters), n_envs=n_envs, dimensions=2, cell_m=0.04, box_m=BOX
    )
    for k in range(periods):
        turn = np.sin(2 * np.pi * 1.5 * CONTROL_S * k - 1.2 * np.arange(3))
        swimmer.step(wave * np.array([0.3, 0.45, 0.6]) * turn)
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
    swimmer = Swimmer(FISH, with_effects(**parameters), dimensions=2, cell_m=0.04, box_m=BOX)
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
    def glide(**parameters):
        swimmer = Swimmer(FISH, with_effects(**parameters), dimensions=2, cell_m=0.04, box_m=BOX)
        q, v = swimmer.bodies.motion.q.numpy(), np.zeros((1, 6))
        v[0, 0] = 0.3
        swimmer.bodies.place(q, v)
        for _ in range(25):
            swimmer.step(np.zeros(3))
        return swimmer.state().velocity[0, 0]

    plain = glide()
    assert 0.05 < plain < 0.3
    assert glide(linear_drag__coefficient=2.0) < 0.8 * plain
    assert glide(form_drag__coefficient=1.0) < 0.95 * plain
    assert glide(form_drag__coefficient=-0.2) > 1.01 * plain
    names = {link.material for link in FISH.links}
    rough = {f"surface_friction__{name or ''}__coefficient": 0.1 for name in names}
    assert glide(**rough) < 0.95 * plain


def test_a_mass_to_the_left_is_pushed_to_the_right():
    swimmer = Swimmer(
        FISH, with_effects(com_offset__y_m=0.03), dimensions=2, cell_m=0.02, box_m=BOX
    )
    head = swimmer.state().pose[0]
    assert head[1] == pytest.approx(0.0, abs=1e-12)  # coordinates are those of the mass
    swimmer.bodies.push(np.array([[0.3, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    for _ in range(20):
        swimmer.step(np.zeros(3))
    assert swimmer.state().pose[0, 2] < -1e-3
