"""The path of docs/how-to/elsewhere.md with logs of a servo that is not the library's own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from own_servo import INERTIA, Servo, write_log

from sim2real.cli import main
from sim2real.exporters.mujoco_bench import simulate
from sim2real.recording import read_recording

COLUMNS = ["--columns", "t=time_ms", "pan.command=goal", "pan.position=present"]
UNITS = ["--time-unit", "ms", "--units", "counts", "--counts-per-turn", "4096"]
UNITS += ["--zero-count", "2048", "--inertia", f"pan={INERTIA}"]
ROBOT = """name = "bench"

[[joints]]
name = "pan"
servo = "mine"
limits_rad = [-1.0, 1.0]

[servos.mine]
max_torque_Nm = 1.5
no_load_speed_rad_s = 10.0
position_step_rad = 0.00153
"""


def imported(servo: Servo, folder: Path) -> list[str]:
    """Three recordings, imported from logs; the last is for nobody to see but the judge."""
    paths = []
    for seed, kind in enumerate(("steps", "triangle", "chirp")):
        log, out = folder / f"{kind}_log.csv", folder / f"{kind}.csv"
        write_log(servo, kind, log, seed)
        assert main(["import", str(log), *COLUMNS, *UNITS, "--out", str(out)]) == 0
        paths.append(str(out))
    (folder / "robot.toml").write_text(ROBOT)
    return paths


def error_of(xml: Path, recording: str) -> float:
    """RMS of MuJoCo against a recording, rad."""
    log = read_recording(recording)
    seen = simulate(xml.read_text(), log.t, {"pan": log.command[:, 0]})["pan"]
    return float(np.sqrt(np.mean((seen - log.position[:, 0]) ** 2)))


@pytest.mark.parametrize(
    ("servo", "effect", "worst_rad"),
    [
        (Servo(friction_Nm=0.03), "coulomb_friction", 0.0012),
        (Servo(deadband_rad=0.02), "deadband", 0.0012),
    ],
    ids=["friction", "dead band"],
)
def test_the_enriched_model_is_as_near_to_the_log_as_the_plain_one(
    servo: Servo, effect: str, worst_rad: float, tmp_path: Path
) -> None:
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    *given, unseen = imported(servo, tmp_path)
    robot = ["--robot", str(tmp_path / "robot.toml")]
    plain, found = tmp_path / "model.json", tmp_path / "diagnosis.json"
    assert main(["check", *given, *robot]) == 0
    assert main(["identify", *given, *robot, "--out", str(plain), "--no-plots"]) == 0
    assert main(["diagnose", *given, *robot, "--out", str(found), "--no-page"]) == 0
    assert json.loads(found.read_text())["effects"][0]["effect"] == effect
    errors = []
    for model in (plain, tmp_path / "diagnosis.enriched.json"):
        out = model.with_suffix(".xml")
        call = ["export-servo", str(model), "--to", "mujoco", "--out", str(out)]
        assert main([*call, "--recordings", *given]) == 0
        errors.append(error_of(out, unseen))
    assert errors[1] < 1.05 * errors[0]
    assert errors[1] < worst_rad
