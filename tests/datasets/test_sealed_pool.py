"""The sealed swims: what is drawn, what water and camera do to them, what a knower can tell."""

import json
from pathlib import Path

import numpy as np
import pytest

from sim.robot.shape import hull_of
from sim2real.body import observed
from sim2real.recording import read_recording
from sim2real.robot import read_robot

POOL = Path(__file__).parents[2] / "datasets" / "pool"


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
