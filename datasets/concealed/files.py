"""Cases as files: what the tool is given, what only the grader sees, and the answers."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from bench import JOINTS
from cases import Case, Take

SOURCE = "Simulated bench of the sealed challenge 'find the missing physics'. MIT licence."
LIMITS_RAD = (-1.57, 1.57)


def write_case(case: Case, name: str, out: Path) -> None:
    """Write the recordings a and b, robot and model as inputs, recording c as held out."""
    inputs, held_out = out / "inputs" / name, out / "heldout" / name
    for folder in (inputs, held_out):
        folder.mkdir(parents=True)
    (inputs / "robot.toml").write_text(robot_toml(case))
    for recording, take in case.takes.items():
        folder = held_out if recording == "c" else inputs
        (folder / f"{recording}.csv").write_text(table(take))
        (folder / f"{recording}.json").write_text(_json(sidecar(case, recording)))
    if case.model:
        content = {
            "schema": "sim2real.model/1",
            "joints": {
                joint: {**numbers, "interval": {}, "effects": []}
                for joint, numbers in case.model.items()
            },
            "body": {"effects": []},
            "effects": [],
            "fit": {},
            "provenance": {},
        }
        (inputs / "model.json").write_text(_json(content))


def table(take: Take) -> str:
    """A recording as CSV."""
    joints = JOINTS[: take.command.shape[1]]
    header = ["t_s"] + [f"{j}.{q}" for j in joints for q in ("command_rad", "position_rad")]
    columns = [take.t]
    for j in range(len(joints)):
        columns += [take.command[:, j], take.measured[:, j]]
    rows = np.stack(columns, axis=1).tolist()
    lines = [",".join("" if x != x else f"{x:z.6f}" for x in row) for row in rows]
    return "\n".join([",".join(header), *lines]) + "\n"


def sidecar(case: Case, recording: str) -> dict[str, Any]:
    """The JSON beside a recording."""
    loads = {
        joint: vars(servo.loads[recording])
        for joint, servo in zip(JOINTS, case.servos, strict=False)
    }
    return {
        "schema": "sim2real.recording/1",
        "kind": "servo",
        "joints": list(JOINTS[: len(case.servos)]),
        "loads": loads,
        "medium": "air",
        "source": SOURCE,
    }


def robot_toml(case: Case) -> str:
    """The robot with the data sheets of its three servos."""
    parts = ['name = "bench of servos"\n']
    for link in ("frame", "arm1", "arm2", "arm3")[: len(case.servos) + 1]:
        size = "length_m = 0.10\nwidth_m = 0.05\nheight_m = 0.05"
        parts.append(f'[[links]]\nname = "{link}"\nmass_kg = 0.2\n{size}\n')
    for j, joint in enumerate(JOINTS[: len(case.servos)]):
        limits = f"limits_rad = [{LIMITS_RAD[0]}, {LIMITS_RAD[1]}]"
        parts.append(f'[[joints]]\nname = "{joint}"\nservo = "servo{j + 1}"\n{limits}\n')
    for j, servo in enumerate(case.servos):
        most = servo.stated.get("max_torque_Nm", servo.stall_Nm)
        fastest = servo.stated.get("no_load_speed_rad_s", servo.no_load_speed_rad_s)
        parts.append(
            f"[servos.servo{j + 1}]\n"
            f"max_torque_Nm = {most:.2f}\n"
            f"no_load_speed_rad_s = {fastest:.2f}\n"
            f"position_step_rad = {servo.sensor.step_rad:.5f}\n"
        )
    return "\n".join(parts)


def answer(case: Case, name: str) -> dict[str, Any]:
    """What is true of a case. A parameter that begins with an underscore is in ``detail``."""
    effects = [
        {
            "effect": hidden.effect,
            "component": hidden.component,
            "parameters": {k: v for k, v in hidden.parameters.items() if k[0] != "_"},
            "strength": hidden.strength,
            "driver": hidden.driver,
            "detail": {k[1:]: v for k, v in hidden.parameters.items() if k[0] == "_"},
        }
        for hidden in case.hidden
    ]
    windows = {recording: take.windows for recording, take in case.takes.items()}
    return {
        "case": name,
        "kind": case.kind,
        "trap": case.trap,
        "clock_disturbed": case.disturbed,
        "model_given": ("wrong" if case.model_wrong else "right") if case.model else "none",
        "effects": effects,
        "windows_s": windows if any(windows.values()) else {},
        "driver": case.hidden[0].driver if case.hidden else "none",
        "joints": {
            joint: {
                "kp_Nm_per_rad": servo.kp,
                "kd_Nms_per_rad": servo.kd,
                "latency_s": servo.latency_s,
                "rotor_inertia_kgm2": servo.rotor_inertia,
                "noise": vars(servo.sensor),
            }
            for joint, servo in zip(JOINTS, case.servos, strict=False)
        },
    }


def hashes(out: Path) -> dict[str, Any]:
    """SHA-256 of the answers, of every file of the generator and of all recordings together."""
    generator = sorted(Path(__file__).parent.glob("*.*"))
    data = hashlib.sha256()
    for path in sorted([*(out / "inputs").rglob("*.*"), *(out / "heldout").rglob("*.*")]):
        data.update(f"{path.relative_to(out).as_posix()} {_sha256(path)}\n".encode())
    return {
        "answers.json": _sha256(out / "answers.json"),
        "recordings": data.hexdigest(),
        "generator": {path.name: _sha256(path) for path in generator},
    }


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _json(content: object) -> str:
    return json.dumps(content, indent=2) + "\n"
