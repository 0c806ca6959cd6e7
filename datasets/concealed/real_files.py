"""Cases of real recordings as files: inputs, held-out recordings, answers, hashes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from backgrounds import Log

GENERATOR = (
    "backgrounds.py",
    "injections.py",
    "interventions.py",
    "real.py",
    "real_effects.py",
    "real_files.py",
    "real_outside.py",
)
"""Files that decide what is written."""
SOURCES = {
    "xl330": "Rhoban, BAM: Better Actuator Models (github.com/Rhoban/bam), Apache-2.0; adapted.",
    "sts": "B. Kotov, Robonine (doi 10.5281/zenodo.17903002), CC BY 4.0; adapted.",
    "emps": "A. Janot, M. Gautier, M. Brunot: Data Set and Reference Models of EMPS; adapted.",
}
SERVOS = {  # max_torque_Nm, no_load_speed_rad_s, position_step_rad
    "xl330": (0.71, 15.9, 0.00153398),
    "sts": (2.94, 4.71, 0.00153398),
    "emps": (400.0, 10.0, 5e-8),
}


def write(cases: list[Any], seed: int, out: Path) -> None:
    """Inputs, held-out recordings, answers and hashes of one set."""
    answers = []
    for k, (takes, answer) in enumerate(cases):
        name = f"case_{k + 1:04d}"
        inputs, held_out = out / "inputs" / name, out / "heldout" / name
        for folder in (inputs, held_out):
            folder.mkdir(parents=True)
        (inputs / "robot.toml").write_text(robot_toml(takes["a"]))
        for recording, log in takes.items():
            folder = held_out if recording == "c" else inputs
            (folder / f"{recording}.csv").write_text(table(log))
            (folder / f"{recording}.json").write_text(json.dumps(sidecar(log), indent=2) + "\n")
        answers.append({"case": name, **answer, "seed": seed})
    (out / "answers.json").write_text(json.dumps(answers, indent=1) + "\n")
    (out / "hashes.json").write_text(json.dumps(hashes(out), indent=1) + "\n")


def hashes(out: Path) -> dict[str, Any]:
    """SHA-256 of the answers, of all recordings together, of each file of the generator."""
    data = hashlib.sha256()
    for path in sorted([*(out / "inputs").rglob("*.*"), *(out / "heldout").rglob("*.*")]):
        data.update(f"{path.relative_to(out).as_posix()} {_sha256(path)}\n".encode())
    return {
        "answers.json": _sha256(out / "answers.json"),
        "recordings": data.hexdigest(),
        "generator": {name: _sha256(Path(__file__).with_name(name)) for name in GENERATOR},
    }


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def table(log: Log) -> str:
    """A recording as CSV."""
    header, columns = ["t_s"], [log.t]
    for j, joint in enumerate(log.joints):
        header += [f"{joint}.command_rad", f"{joint}.position_rad"]
        columns += [log.command[:, j], log.position[:, j]]
    digits = 9 if log.family == "emps" else 6
    rows = np.stack(columns, axis=1).tolist()
    lines = [",".join("" if x != x else f"{x:z.{digits}f}" for x in row) for row in rows]
    return "\n".join([",".join(header), *lines]) + "\n"


def sidecar(log: Log) -> dict[str, Any]:
    """The JSON beside a recording."""
    return {
        "schema": "sim2real.recording/1",
        "kind": "servo",
        "joints": log.joints,
        "loads": {"j1": log.load} if log.load else {},
        "medium": "air",
        "source": SOURCES[log.family],
    }


def robot_toml(log: Log) -> str:
    """A robot whose links say nothing of the load."""
    torque, speed, step = SERVOS[log.family]
    parts = ['name = "bench"\n']
    for k in range(len(log.joints) + 1):
        size = "length_m = 0.10\nwidth_m = 0.05\nheight_m = 0.05"
        parts.append(f'[[links]]\nname = "link{k}"\nmass_kg = 0.2\n{size}\n')
    for joint in log.joints:
        limits = "limits_rad = [-3.14, 3.14]"
        parts.append(f'[[joints]]\nname = "{joint}"\nservo = "servo"\n{limits}\n')
    parts.append(
        f"[servos.servo]\nmax_torque_Nm = {torque}\nno_load_speed_rad_s = {speed}\n"
        f"position_step_rad = {step:.8f}\n"
    )
    return "\n".join(parts)
