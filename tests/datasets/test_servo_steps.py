"""The recordings that ship: made by their program, true to their truth, unknown to the library."""

import ast
import dataclasses
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim2real.recording import read_recording
from sim2real.robot import read_robot

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "datasets" / "servo_steps"
NAMES = ("steps", "sine", "square", "chirp")
JOINTS = ("j1", "j2", "j3")


@pytest.fixture(scope="module")
def make():
    spec = importlib.util.spec_from_file_location("servo_steps_make", FOLDER / "make.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up by name
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module", params=NAMES)
def recording(request):
    return read_recording(FOLDER / f"{request.param}.csv")


@pytest.fixture(scope="module")
def motions(make, recording):
    """True angle and velocity of each joint, (T, 2), by name."""
    t, commands = recording.t, recording.command.T
    servos = make.SERVOS.items()
    return {
        j: make.simulate(servo, t, t, c) for (j, servo), c in zip(servos, commands, strict=True)
    }


@pytest.fixture(scope="module")
def robot():
    return read_robot(FOLDER / "robot.toml")


def test_the_program_makes_the_committed_files_again(make, tmp_path):
    make.main(["--out", str(tmp_path)])
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(made) == {f"{n}.{e}" for n in NAMES for e in ("csv", "json")} | {"truth.json"}
    assert made == {name: (FOLDER / name).read_bytes() for name in made}


@pytest.mark.parametrize("name", NAMES)
def test_another_seed_makes_another_recording(make, monkeypatch, name):
    at_once = lambda servo, t, sent, command: np.stack([command, 0 * t], axis=1)  # noqa: E731
    monkeypatch.setattr(make, "simulate", at_once)  # the motion draws nothing
    one, same, other = (make.record(name, np.random.default_rng(seed)) for seed in (1, 1, 2))
    for column in ("t_s", "j1.position_rad"):
        np.testing.assert_array_equal(one[column], same[column])
        assert not np.array_equal(one[column], other[column])


def test_a_recording_is_as_the_format_says(recording):
    truth = json.loads((FOLDER / "truth.json").read_text())
    assert (recording.kind, recording.joints, recording.medium) == ("servo", JOINTS, "air")
    assert "Simulated" in recording.source and "make.py" in recording.source
    assert recording.duration_s == pytest.approx(30.0, abs=0.01)
    for joint, load in recording.loads.items():
        assert load.inertia_kgm2 == truth["joints"][joint]["inertia_kgm2"]
        assert load.gravity_Nm == 0


def test_times_are_jittered_and_one_recording_has_a_gap(recording):
    dt = np.diff(recording.t)
    gaps = dt > 0.03
    assert gaps.sum() == (1 if recording.name == "steps" else 0)
    # The difference of two independent jitters of 0.3 ms.
    assert dt[~gaps].std() == pytest.approx(0.0003 * np.sqrt(2), rel=0.1)


def test_a_few_samples_are_missing_and_no_command(recording):
    assert np.isfinite(recording.command).all()
    assert 0 < np.isnan(recording.position).sum() < 20


def test_positions_are_whole_encoder_steps(recording, robot):
    step = robot.joints[0].servo.position_step_rad
    counts = recording.position[np.isfinite(recording.position)] / step
    np.testing.assert_allclose(counts, np.round(counts), rtol=0, atol=1e-6)
    assert np.unique(np.round(counts)).size > 50


def test_starts_at_rest_on_the_first_command(recording):
    held = recording.t < 0.5
    np.testing.assert_array_equal(recording.command[held], 0)
    at_rest = recording.position[recording.t < 0.55]
    assert np.nanmax(np.abs(at_rest)) < 2.5 * 0.00419
    assert abs(np.nanmean(at_rest)) < 0.001


def test_stays_within_the_joint_limits(recording, robot):
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits_rad
        angles = np.stack([recording.command[:, j], recording.position[:, j]])
        assert low < np.nanmin(angles) and np.nanmax(angles) < high


def test_measured_is_the_true_motion_with_noise_and_rounding(make, motions, recording):
    truth = json.loads((FOLDER / "truth.json").read_text())
    expected = np.hypot(truth["noise_sd_rad"], 0.00419 / np.sqrt(12))
    for j, joint in enumerate(JOINTS):
        assert make.Servo(**truth["joints"][joint]) == make.SERVOS[joint]
        error = recording.position[:, j] - motions[joint][:, 0]
        # Rounding a servo that stands still is no uniform noise, so the sd is not exact.
        assert np.nanstd(error) == pytest.approx(expected, rel=0.1)
        assert abs(np.nanmean(error)) < 0.0003
        assert np.nanmax(np.abs(error)) < 5 * truth["noise_sd_rad"] + 0.00419 / 2


def test_the_motor_obeys_a_line_near_the_data_sheet_s(make, motions, recording, robot):
    fastest = []
    for j, joint in enumerate(robot.joints):
        servo, command = make.SERVOS[joint.name], recording.command[:, j]
        assert servo.stall_torque_Nm == pytest.approx(joint.servo.max_torque_Nm, rel=0.1)
        assert servo.no_load_speed_rad_s == pytest.approx(joint.servo.no_load_speed_rad_s, rel=0.1)
        fastest.append(np.abs(motions[joint.name][:, 1]).max() / servo.no_load_speed_rad_s)
        if recording.name in ("steps", "square"):
            limited = dataclasses.replace(servo, stall_torque_Nm=np.inf)
            _, wanted = make.simulate(limited, recording.t, recording.t, command).T
            assert np.abs(wanted).max() > 1.5 * servo.no_load_speed_rad_s
    assert max(fastest) < 1 + 1e-9


@pytest.mark.parametrize("joint", JOINTS)
def test_the_closed_form_agrees_with_numerical_integration(make, joint):
    rng = np.random.default_rng(3)
    sent = np.cumsum(rng.uniform(0.01, 0.03, size=60))
    command = rng.uniform(-0.6, 0.6, size=60)
    t = np.sort(rng.uniform(sent[0], sent[-1], size=200))
    servo = make.SERVOS[joint]

    def motion(_, state, target):
        position, velocity = state
        torque = servo.kp_Nm_per_rad * (target - position) - servo.kd_Nms_per_rad * velocity
        line = -servo.stall_torque_Nm / servo.no_load_speed_rad_s * velocity
        torque = np.clip(torque, line - servo.stall_torque_Nm, line + servo.stall_torque_Nm)
        return velocity, torque / servo.inertia_kgm2

    # One command after the other, so that the integrator meets no jump inside a piece.
    edges = np.concatenate([[sent[0]], sent + servo.latency_s])
    targets = np.concatenate([command[:1], command])
    state, pieces = np.array([command[0], 0.0]), []
    for start, stop, target in zip(edges[:-1], edges[1:], targets[:-1], strict=True):
        piece = solve_ivp(
            motion,
            (start, stop),
            state,
            "LSODA",
            np.append(t[(t >= start) & (t < stop)], stop),
            args=(target,),
            rtol=1e-11,
            atol=1e-12,
            max_step=2e-4,
        ).y
        pieces.append(piece[:, :-1])
        state = piece[:, -1]
    expected = np.concatenate(pieces, axis=1).T
    found = make.simulate(servo, t, sent, command)
    np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found[:, 1], expected[:, 1], rtol=0, atol=1e-5)


def test_the_robot_is_the_paper_s(robot):
    assert tuple(joint.name for joint in robot.joints) == JOINTS
    assert sum(link.length_m for link in robot.links) == pytest.approx(0.52)
    assert sum(link.mass_kg for link in robot.links) == pytest.approx(1.1)
    assert max(link.width_m for link in robot.links) == 0.13
    assert [link.material for link in robot.links] == ["abs", "rubber", "rubber", "abs"]


def test_no_library_code_knows_the_truth():
    files = [
        path
        for package in ("sim2real", "sim", "rl")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    assert files
    assert [str(path) for path in files if b"truth.json" in path.read_bytes()] == []


def test_the_program_imports_nothing_from_the_library():
    imported = set()
    for node in ast.walk(ast.parse((FOLDER / "make.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(node.module.split(".")[0])
    assert imported <= set(sys.stdlib_module_names) | {"numpy"}
