"""``export-servo`` and ``export-ranges``: what they print, and that nothing is half-written."""

import json
from pathlib import Path

import good_input
import numpy as np
import pytest
from good_input import MODEL, ROBOT, message
from simulated import steps

import sim2real as s2r
from sim2real.cli import main
from sim2real.exporters.mujoco_bench import simulate
from sim2real.recording import read_recording


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(MODEL))
    return path


@pytest.mark.parametrize("target", ["mujoco", "isaaclab", "urdf", "json"])
def test_what_is_lacking_is_printed_and_written(model, target, capsys):
    out, robot = model.with_name("out.txt"), model.with_name("robot.toml")
    robot.write_text(ROBOT)
    call = ["export-servo", str(model), "--to", target, "--out", str(out), "--robot", str(robot)]
    # Without friction or inertia of the output MuJoCo's play is no better than a plain servo.
    assert main([*call, "--which", "effects"] if target == "mujoco" else call) == 0
    first, *listed = said = capsys.readouterr().out.splitlines()
    assert first == f"{out}: for {target}"
    text = out.read_text()
    if target == "json":
        assert not listed
        assert json.loads(text)["joints"]["j1"]["effects"][0]["effect"] == "backlash"
    elif target == "mujoco":  # has all of it
        assert not any("backlash" in line for line in listed)
        assert 'range="-0.015 0.015"' in text
    else:
        costs = [line for line in listed[1:] if not line.startswith("  ")]
        listed = [line for line in listed if line not in costs]
        assert costs[0].startswith("j1: refitted without backlash: ")
        assert any("backlash (gap_rad = 0.03)" in line for line in listed[1:])
        assert all(line.strip() in text for line in listed[1:])
    if target != "mujoco":
        exported = s2r.export(model, target, robot=robot)
        assert exported.text == text
        assert str(exported).split("\n") == (said[1:] or [""])


def test_ranges(tmp_path, capsys):
    out = tmp_path / "ranges.py"
    call = ["export-ranges", "datasets/pool/ranges.json", "--to", "isaaclab", "--out", str(out)]
    assert main(call) == 0
    assert "position_noise_m" in capsys.readouterr().out
    assert "position_noise_m" in out.read_text()
    assert s2r.export("datasets/pool/ranges.json", "isaaclab").text == out.read_text()
    message(lambda: s2r.export("datasets/pool/ranges.json", "mujoco"), "to", "'mujoco'", "newton")


def test_refused(model, capsys):
    def refused(*parts, command="servo", source=model, to="urdf"):
        call = [f"export-{command}", str(source), "--to", to, "--out", str(out)]
        good_input.refused(capsys, main(call), *parts)

    out = model.parent
    refused("a folder")
    out = model.with_name("out.xml")
    refused("no such file", source="no.json")
    refused("schema", command="ranges", to="isaaclab")
    with pytest.raises(SystemExit) as stop:
        refused(to="gazebo")
    assert stop.value.code == 2
    assert not out.exists()


COUNTS, ZERO, INERTIA, STEP_S = 4096, 2048, 0.0021, 2e-4
OPTIONS = ["--columns", "t=time_ms", "j1.command=goal", "j1.position=present", "--time-unit", "ms"]
OPTIONS += ["--units", "counts", "--counts-per-turn", "4096", "--zero-count", "2048"]


def turned(t: np.ndarray, goal: np.ndarray, friction: float, deadband: float) -> np.ndarray:
    """Angles in rad on set-points: PD control after 35 ms, by semi-implicit Euler."""
    ticks = np.arange(0.0, t[-1] + STEP_S, STEP_S)
    in_force = goal[np.maximum(np.searchsorted(t + 0.035, ticks, "right") - 1, 0)]
    q = v = 0.0
    angle = np.empty(ticks.size)
    slowed = STEP_S * friction / INERTIA
    for k, u in enumerate(in_force.tolist()):
        angle[k] = q
        error = u - q
        error -= min(max(error, -deadband), deadband)
        v += STEP_S * (1.4 * error - 0.05 * v) / INERTIA
        v = 0.0 if abs(v) < slowed else v - np.sign(v) * slowed
        q += STEP_S * v
    return np.interp(t, ticks, angle)


def imported(folder: Path, **servo: float) -> list[str]:
    """Three recordings from logs in counts with clock jitter and noise; the last is for no fit."""
    paths = []
    for seed, kind in enumerate(("steps", "triangle", "chirp")):
        rng = np.random.default_rng(seed)
        t = 0.01 * np.arange(800)
        t[1:] += rng.uniform(-1e-3, 1e-3, t.size - 1)
        s = np.maximum(t - 0.5, 0.0)
        goal = {
            "steps": steps(t, rng),
            "triangle": np.arcsin(np.sin(2 * np.pi * 0.3 * s)) / np.pi,
            "chirp": 0.4 * np.sin(2 * np.pi * (0.1 + 0.1 * s) * s),
        }[kind]
        count = 2 * np.pi / COUNTS
        goal = np.rint(goal / count)
        present = turned(t, count * goal, **servo) + rng.normal(0, 0.0006, t.size)
        rows = np.column_stack([1e3 * t + 5000, goal + ZERO, np.rint(present / count) + ZERO])
        log, out = folder / f"{kind}_log.csv", folder / f"{kind}.csv"
        header = "time_ms,goal,present"
        np.savetxt(log, rows, fmt="%.3f", delimiter=",", header=header, comments="")
        call = ["import", str(log), *OPTIONS, "--inertia", f"j1={INERTIA}", "--out", str(out)]
        assert main(call) == 0
        paths.append(str(out))
    return paths


@pytest.mark.parametrize(
    ("friction", "deadband", "effect"), [(0.03, 0.0, "coulomb_friction"), (0.0, 0.02, "deadband")]
)
def test_the_enriched_model_is_as_near_to_the_log_as_the_plain_one(
    friction: float, deadband: float, effect: str, tmp_path: Path
) -> None:
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    *given, unseen = imported(tmp_path, friction=friction, deadband=deadband)
    (tmp_path / "robot.toml").write_text(ROBOT)
    robot = ["--robot", str(tmp_path / "robot.toml")]
    plain, found = tmp_path / "model.json", tmp_path / "diagnosis.json"
    assert main(["check", *given, *robot]) == 0
    assert main(["identify", *given, *robot, "--out", str(plain), "--no-plots"]) == 0
    assert main(["diagnose", *given, *robot, "--out", str(found), "--no-page"]) == 0
    assert json.loads(found.read_text())["effects"][0]["effect"] == effect
    log, errors = read_recording(unseen), []
    for model in (plain, tmp_path / "diagnosis.enriched.json"):
        out = model.with_suffix(".xml")
        call = ["export-servo", str(model), "--to", "mujoco", "--out", str(out)]
        assert main([*call, "--recordings", *given]) == 0
        seen = simulate(out.read_text(), log.t, {"j1": log.command[:, 0]})["j1"]
        errors.append(float(np.sqrt(np.mean((seen - log.position[:, 0]) ** 2))))
    assert errors[1] < 1.05 * errors[0]
    assert errors[1] < 0.0012
