"""The pool that nobody has: its laws, that it can be made again, and policies that swim in it."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from rl.experiments.reality import read_reality
from sim.fluid.fluid import Fluid
from sim.robot.shape import hull_of
from sim2real.body import observed
from sim2real.recording import read_recording
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
    still, ahead = np.zeros((2, 3, 6))
    ahead[:, 0] = 0.3
    rough.add(still, np.zeros((3, 6)), ahead)
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
    for folder in ("a", "b"):  # in a process of its own, and in this one
        call = ["make.py", str(tmp_path / folder), "--seconds", "0.06", "--cell-m", "0.04"]
        monkeypatch.setattr(sys, "argv", call)
        code["make"].main()
        texts.append({p.name: p.read_bytes() for p in sorted((tmp_path / folder).iterdir())})
        here = lambda processes, mp_context: ThreadPoolExecutor(processes)  # noqa: E731
        monkeypatch.setattr(code["make"], "ProcessPoolExecutor", here)
    assert texts[0] == texts[1]
    assert len(texts[0]) == 15


def test_the_same_seed_draws_the_same_set(code):
    made = code["sealed"].made
    one, other, third = (made(seed, 4, 2, code["sealed"].COUNTS) for seed in (5, 5, 6))
    assert one[0] == other[0]
    assert one[1] == other[1]
    assert one[0] != third[0]
    strengths = [s for seed in range(6) for c in made(seed, 4, 0, code["sealed"].COUNTS)[1]
                 for s in c.strength.values()]  # fmt: skip
    assert min(strengths) < 0.4
    assert 2.0 < max(strengths) <= 3.0
    chosen = code["sealed"].made(5, 4, 2, code["sealed"].COUNTS, ("tether", "coulomb_friction"))[1]
    drawn = {name for case in chosen if case.kind == "single" for name in case.effects}
    assert drawn == {"tether", "coulomb_friction"}


def test_each_servo_has_its_own_friction(code):
    concealed = {"coulomb_friction": {"torque_Nm": 0.01, "j2.torque_Nm": 0.03}}
    truths = [code["truth"].Truth("x", concealed), code["truth"].Truth("y")]
    servos = code["servos"].Servos(truths, 3, 1e-3, np.random.default_rng(0))
    turn, rate = np.zeros((2, 3)), np.full((2, 3), 10.0)
    lost = np.diff(servos.torque(0.0, turn, rate, np.zeros((2, 1))), axis=0)[0]
    np.testing.assert_allclose(lost, [0.01, 0.04, 0.01])


def test_a_drawn_robot_carries_a_bar_whose_drag_its_file_states(code, tmp_path):
    file = tmp_path / "robot.toml"
    drawn, *_ = code["sealed"].made(3, 4, 1, code["sealed"].COUNTS)
    file.write_text(code["sealed"].robot_toml(drawn))
    robot = read_robot(file)
    (bar,) = robot.appendages
    stated = drawn.robot.appendages[0]
    assert (bar.size_m, bar.at_m, bar.axis) == (stated.size_m, stated.at_m, stated.axis)
    assert bar.drag == pytest.approx(stated.drag)
    (wetted,) = (one.wetted(np.inf) for one in robot.appendages)
    assert 19e-4 < wetted.area_m2[0] < 61e-4
    hull = hull_of(robot)
    links = code["surfaces"].Links(hull, 0.1)
    truths = [code["truth"].Truth("x", areas=areas) for areas in (1.0, 1.2)]
    drag = code["surfaces"].Surfaces(truths, robot, hull, links)
    J = len(robot.joints)
    ahead, turning = np.zeros((2, 2, 3 + J))
    ahead[:, 0], turning[:, 2] = 0.3, 2.0
    for v in (ahead, turning):
        out = np.zeros((2, 3 + J))
        drag.add(out, np.zeros((2, 3 + J)), v)
        if v is ahead:
            assert out[0, 0] == pytest.approx(-0.5 * 1000 * wetted.area_m2[0] * 0.09)
            assert np.allclose(out[:, 1:], 0)
        power = (out * v).sum(axis=1)
        assert power[0] < 0
        assert power[1] == pytest.approx(1.2 * power[0])


def test_water_that_is_carried_gives_back_what_it_took(code):
    """Straight across and to a stop: the impulses add up to nothing, but for the last instant."""
    robot = read_robot(POOL / "robot.toml")
    hull = hull_of(robot)
    truths = [code["truth"].Truth("x", {"added_mass": {"ratio": 0.3}})]
    waters = code["waters"].Waters(truths, hull, code["surfaces"].Links(hull, 0.1), 1e-3)
    impulse, most = 0.0, 0.0
    for k in range(1100):
        v = np.zeros((1, 6))
        v[0, 1] = 0.3 * np.sin(np.pi * k / 1000) if k < 1000 else 0.0
        out = np.zeros((1, 6))
        waters.add(out, np.zeros((1, 6)), v, np.zeros((1, 2)), 1e-3 * k)
        impulse += 1e-3 * out[0, 1]
        most = max(most, abs(impulse))
    assert most > 0.02
    assert abs(impulse) < 0.01 * most


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("camera_latency", {"latency_s": 0.06}),
        ("camera_rotation", {"angle_rad": 0.2}),
        ("camera_scale", {"ratio": 0.1}),
        ("marker_offset", {"x_m": 0.03, "y_m": -0.02}),
        ("pose_filter", {"time_constant_s": 0.05}),
    ],
)
def test_the_camera_has_the_faults_that_the_catalogue_means(code, effect, parameters):
    """Written twice, by the same definition."""
    t = 0.02 * np.arange(300)
    pose = np.stack([0.3 * t, 0.2 * np.sin(t), 0.5 * np.sin(2 * t)], axis=1)
    shown = code["camera"].seen(
        t, pose, np.zeros((300, 3)), {effect: parameters}, np.random.default_rng(0)
    )
    ours = observed(t, pose, {f"{effect}.{k}": v for k, v in parameters.items()})
    assert np.abs(shown - ours).max() < 0.01 * np.ptp(pose)
    assert np.abs(shown - pose).max() > 0.005


def test_a_set_is_made_answered_for_and_published(code, tmp_path):
    few = [
        f"--{kind}={n}" for kind, n in (("null", 1), ("single", 1), ("double", 0), ("outside", 0))
    ]
    code["sealed"].main(
        [str(tmp_path), "--seed=4", "--robots=1", "--cell-m=0.04", "--seconds=0.3", *few]
    )
    answers = json.loads((tmp_path / "answers.json").read_text())
    assert sorted(one["kind"] for one in answers["cases"]) == ["null", "single"]
    assert all(np.isfinite(one["oracle"]["llr_total"]) for one in answers["cases"])
    swim = read_recording(tmp_path / "inputs" / "robot_01" / answers["cases"][0]["case"] / "a.csv")
    assert swim.t.size == 15
    assert (tmp_path / "heldout" / answers["cases"][0]["case"] / "b.csv").exists()
    published = json.loads((tmp_path / "hashes.json").read_text())
    assert published == code["sealed"].hashes(tmp_path)
    inputs = "".join(p.read_text() for p in (tmp_path / "inputs").rglob("*.json"))
    hidden = [e["effect"] for one in answers["cases"] for e in one["effects"]]
    assert not any(name in inputs for name in hidden)
