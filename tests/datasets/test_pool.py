"""The pool that nobody has: its laws, that it can be made again, and policies that swim in it."""

import sys
from pathlib import Path

import numpy as np
import pytest

from rl.experiments.reality import read_reality
from sim.fluid.fluid import Fluid
from sim.robot.shape import hull_of
from sim2real.robot import read_robot

POOL = Path(__file__).parents[2] / "datasets" / "pool"
H = 5e-4


@pytest.fixture
def servos(code):
    def make(n=1, seed=0, **effects):
        truth = code["truth"].Truth("x", effects)
        return code["servos"].Servos([truth] * n, 3, H, np.random.default_rng(seed))

    return make


def test_a_set_point_counts_when_it_arrives(servos):
    one = servos()
    one.send(0.0, np.full((1, 3), 0.1))
    one.send(0.02, np.full((1, 3), 0.2))
    assert one.wanted(0.061).tolist() == [[0.0, 0.0, 0.0]]
    assert one.wanted(0.067).tolist() == [[0.1, 0.1, 0.0]]
    assert one.wanted(0.2).tolist() == [[0.2, 0.2, 0.2]]


def swing(servos, torque_of, seconds=1.0):
    """A shaft of 0.001 kg m2 held by its servo, pushed by ``torque_of(t)``; its angles."""
    turn, rate, angle = np.zeros((1, 3)), np.zeros((1, 3)), []
    for k in range(round(seconds / H)):
        push = servos.torque(k * H, turn, rate, 0.0) + torque_of(k * H)
        rate = rate + H * push / 1e-3
        turn = turn + H * rate
        angle.append(turn[0, 0])
    return np.array(angle)


def test_play_lets_the_shaft_go_through_the_gap(servos):
    tight = swing(servos(), lambda t: 0.002 * np.sign(np.sin(20 * t)))
    loose = swing(servos(backlash={"gap_rad": 0.02}), lambda t: 0.002 * np.sign(np.sin(20 * t)))
    assert np.ptp(tight) < 0.005
    assert 0.018 < np.ptp(loose) < 0.03


def test_rough_surfaces_take_the_power_that_their_links_lose(code):
    """Force times velocity, summed over coordinates, is that summed over links."""
    robot = code["world"].without_drag(read_robot(POOL / "robot.toml"))
    truth = code["truth"].Truth
    rubber, both = ("surface_friction.rubber",), ("surface_friction.rubber", "surface_friction.abs")
    truths = [truth("x", {n: {"coefficient": 0.05} for n in names}) for names in ((), rubber, both)]
    hull = hull_of(robot)
    links = code["surfaces"].Links(hull, 0.1)
    rough = code["surfaces"].Surfaces(truths, robot, hull, links)
    q = np.tile(np.random.default_rng(0).normal(0, 0.5, 6), (3, 1))
    v = np.tile(np.random.default_rng(1).normal(0, 1.0, 6), (3, 1))
    out = np.zeros((3, 6))
    rough.add(out, q, v)
    assert not out[0].any()
    power = (out * v).sum(axis=1)
    assert power[2] < power[1] < 0
    still = np.zeros((3, 6))
    ahead = np.zeros((3, 6))
    ahead[:, 0] = 0.3
    rough.add(still, np.zeros((3, 6)), ahead)
    hull = hull_of(robot)
    area = np.pi * (hull.half_width + hull.half_height).mean(axis=1) * hull.length
    assert np.isclose(still[2, 0], -0.5 * 1000 * 0.05 * 0.09 * area.sum())
    assert np.allclose(still[:, 1:], 0)


@pytest.fixture(scope="module")
def pool():
    """Two robots in cells of 4 cm."""
    before = dict(Fluid.__init__.__kwdefaults__)
    file = read_reality(POOL / "reality.py", cell_m=0.04)
    reality = file(read_robot(POOL / "robot.toml"), 2, 7, "cpu")
    assert Fluid.__init__.__kwdefaults__ == before, "the library's fluid is as it was"
    return file, reality


def swum(reality, steps=6):
    pose = np.array([[0.0, 0.0, 0.0], [0.5, -0.3, 2.0]])
    seen = [reality.reset(pose, np.zeros((2, 3)))]
    seen += [reality.step(np.full((2, 3), 0.3)) for _ in range(steps)]
    return [np.array(x) for x in zip(*seen, strict=True)]


def test_the_pool_is_a_reality(pool):
    file, reality = pool
    pose, joint = swum(reality)
    assert pose.shape == (7, 2, 3)
    assert joint.shape == (7, 2, 3)
    assert np.allclose(pose[0], [[0.0, 0.0, 0.0], [0.5, -0.3, 2.0]], atol=0.05)
    assert np.allclose(joint[:3], 0.0, atol=0.009), "nothing moves before set-points arrive"
    assert (joint[-1] > 0.02).all()
    assert file.options == {"cell_m": 0.04}
    assert file.at_once


def test_the_same_seed_gives_the_same_swim(pool):
    file, _ = pool
    robot = read_robot(POOL / "robot.toml")
    one, other, third = (swum(file(robot, 2, seed, "cpu"), 3) for seed in (5, 5, 6))
    assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    assert not np.array_equal(one[0], third[0])


def test_a_stopped_box_is_not_seen(pool):
    _, reality = pool
    swum(reality, 0)
    reality._world.swimmer.fluid.stopped.assign(np.array([-1, 5], dtype=np.int32))
    pose, joint = reality.step(np.zeros((2, 3)))
    assert np.isfinite(pose[0]).all()
    assert np.isnan(pose[1]).all()
    assert np.isnan(joint[1]).all()
    pose, _ = reality.reset(np.zeros((2, 3)), np.zeros((2, 3)))
    assert np.isfinite(pose).all()


def test_recordings_can_be_made_again(code, tmp_path, monkeypatch):
    texts = []
    for folder in ("a", "b"):
        call = ["make.py", str(tmp_path / folder), "--seconds", "0.06", "--cell-m", "0.04"]
        monkeypatch.setattr(sys, "argv", call)
        code["make"].main()
        texts.append({p.name: p.read_bytes() for p in sorted((tmp_path / folder).iterdir())})
    assert texts[0] == texts[1]
    assert len(texts[0]) == 15
