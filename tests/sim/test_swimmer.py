"""The swimmer as its users meet it: a batch of robots, control periods, states, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from good_input import message
from swimming_robots import FISH, beat, in_a_box, servos

import sim.lattice.populations
from sim.lattice.populations import is_wide
from sim.lattice.velocities import D2Q9, D3Q19, WATER_KG_M3
from sim.robot.shape import displaced
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.view.picture import plane_of
from sim2real.robot import Link, Robot

BOX = (0.9, 0.9, 0.4)


def test_states_have_a_leading_axis_of_environments():
    swimmer = in_a_box(n_envs=2)
    beat(swimmer, 10)
    state = swimmer.state()
    assert state.pose.shape == state.velocity.shape == (2, 3)
    assert state.joint.shape == state.rate.shape == state.torque.shape == (2, 3)
    assert state.force.shape == (2, 4, 3)
    assert state.time == pytest.approx([10 * CONTROL_S] * 2)
    assert np.array_equal(state.stopped, [-1, -1])
    before = state.pose.copy()
    beat(swimmer, 1)
    assert np.array_equal(state.pose, before)  # a state is of its moment
    assert np.abs(state.joint).max() > 0.02


def test_resetting_one_environment_leaves_the_others_alone():
    swimmer, other = in_a_box(n_envs=2), in_a_box(n_envs=2)
    for one in (swimmer, other):
        beat(one, 8)
    swimmer.reset(np.array([True, False]), pose=np.array([0.1, 0.2, 0.3]))
    state = swimmer.state()
    assert state.pose[0] == pytest.approx([0.1, 0.2, 0.3])
    assert np.array_equal(state.joint[0], np.zeros(3))
    assert np.array_equal(state.pose[1], other.state().pose[1])
    fresh = in_a_box(n_envs=2)
    fresh.reset(pose=np.array([0.1, 0.2, 0.3]))
    for one in (swimmer, fresh, other):
        beat(one, 4)
    assert np.array_equal(swimmer.state().joint[0], fresh.state().joint[0])
    assert np.array_equal(swimmer.state().pose[1], other.state().pose[1])


def test_the_rotor_of_a_gear_train_turns_with_the_joint():
    """It adds to the links' inertia, as that of the motor's law does."""
    rotor = 0.004
    names = [
        ("backlash", {"gap_rad": 1e-9, "rotor_inertia_kgm2": rotor}),
        ("unmodelled_inertia", {"inertia_kgm2": rotor}),
    ]
    models = [servos(effects=[name]) for name in names] + [servos()]
    swimmer = in_a_box(model=models, n_envs=3)
    beat(swimmer, 12)
    of_train, of_law, without = swimmer.state().joint
    changed = np.abs(of_law - without).max()
    assert changed > 0.01
    assert np.abs(of_train - of_law).max() < 0.1 * changed


def test_latency_is_what_the_model_says():
    swimmer = in_a_box(model=servos(latency=0.05))
    moved = []
    for _ in range(4):
        swimmer.step(np.full(3, 0.3))
        moved.append(np.abs(swimmer.state().joint).max())
    assert max(moved[:2]) < 1e-9 < moved[2]


@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_robot_floats(dimensions):
    box = {"cell_m": 0.01, "box_m": (0.8, 0.8, 0.3)}
    swimmer = Swimmer(FISH, servos(), dimensions=dimensions, **box)
    surface = np.inf
    if dimensions == 3:
        surface = (swimmer.tank.size[2] - 0.5 - swimmer.bodies.middle) * 0.01
        assert abs(surface) < 0.01
    volume = displaced(swimmer.hull, 0.005, 0.0, dimensions == 2, surface)[:, 0].sum()
    volume *= swimmer.units.depth_m if dimensions == 2 else 1.0
    mass = sum(link.mass_kg for link in FISH.links)
    assert WATER_KG_M3 * volume == pytest.approx(mass, rel=0.05)
    assert swimmer.bodies.displaced[:, 0].sum() == pytest.approx(mass, rel=0.05)


def test_a_heavy_robot_is_under_water():
    heavy = Robot(
        "stone", tuple(replace(k, mass_kg=4 * k.mass_kg) for k in FISH.links), FISH.joints
    )
    swimmer = Swimmer(heavy, servos(), cell_m=0.04, box_m=BOX)
    assert swimmer.bodies.middle == pytest.approx(swimmer.tank.size[2] - 0.5 - BOX[2] / 2 / 0.04)


def test_bad_input_is_refused_in_one_line():
    swimmer = in_a_box(n_envs=2)
    message(lambda: swimmer.step(np.array([[0, 0, 0], [0, np.nan, 0]])), "environment 1", "finite")
    message(lambda: in_a_box(device="cuda:7"), "cuda:7", "cpu")
    message(lambda: Swimmer(FISH, servos(), box_m=(0.5, 0.5, 0.4)), "shorter than the box")
    message(lambda: in_a_box(substeps=3), "substeps", "even")
    short = Link("head", 0.5, 0.02, 0.13, 0.12)
    stub = Robot("stub", (short, *FISH.links[1:]), FISH.joints)
    message(lambda: Swimmer(stub, servos(), box_m=BOX), "overlap")
    message(lambda: in_a_box(n_envs=2, model=[servos()]), "1 models", "2, one for each robot")
    message(lambda: Swimmer(FISH, servos(), cell_m=0.0), "cell_m")


BOTH = pytest.mark.parametrize("lattice", [D2Q9, D3Q19], ids=lambda one: one.name)


@pytest.fixture
def narrow_and_wide(monkeypatch):
    """Do the same in narrow and in wide memory."""

    def twice(work):
        narrow = work()
        monkeypatch.setattr(sim.lattice.populations, "WIDE_FROM", 0)
        return narrow, work()

    return twice


@BOTH
def test_swimmers_are_the_same_bit_for_bit(lattice, narrow_and_wide):
    def swim():
        box = (0.9, 0.7, 0.32)
        swimmer = in_a_box(n_envs=2, dimensions=lattice.dimensions, box_m=box)
        beat(swimmer, 15)
        swimmer.reset(np.array([False, True]))
        beat(swimmer, 25, first=15)
        return swimmer

    narrow, wide = narrow_and_wide(swim)
    assert wide.fluid.wide and not narrow.fluid.wide
    assert np.array_equal(narrow.fluid.f.numpy(), wide.fluid.f.numpy().ravel())
    for name, value in vars(wide.state()).items():
        assert np.array_equal(getattr(narrow.state(), name), value), name
    seen = plane_of(wide).vorticity
    assert np.array_equal(plane_of(narrow).vorticity, seen)
    assert np.abs(seen).max() > 0


def test_memory_is_wide_where_32_bits_end():
    most = 2**31 // 19
    assert not is_wide(D3Q19, most)
    assert is_wide(D3Q19, most + 1)
