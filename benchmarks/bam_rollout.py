"""Angles of BAM's own simulator; called by ``benchmarks/bam_agreement.py`` in BAM's environment.

BAM_PYTHON benchmarks/bam_rollout.py JOB.json ANSWER.json
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path

import bam
import numpy as np
from bam.model import load_model
from bam.simulate import Simulator

PARAMETERS = Path(bam.__file__).parent / "params"


def main() -> None:
    """Simulate every servo of the job on every signal."""
    job = json.loads(Path(sys.argv[1]).read_text())
    if not job.get("servos"):
        files = {f"{p.parent.name}/{p.stem}": json.loads(p.read_text()) for p in _files()}
        answer = {"version": version("better-actuator-models"), "parameters": files}
    else:
        answer = {
            name: {kind: rollout(servo, job["dt_s"], sent) for kind, sent in job["signals"].items()}
            for name, servo in job["servos"].items()
        }
    Path(sys.argv[2]).write_text(json.dumps(answer))


def _files() -> list[Path]:
    return sorted(PARAMETERS.glob("*/m?.json"))


def rollout(servo: dict, dt: float, goals: list[float]) -> list[float]:
    """Angles in rad at every step, from rest at 0."""
    model = load_model(str(PARAMETERS / f"{servo['file']}.json"))
    if servo["without_offset"]:
        model.q_offset.value = 0.0
    entry = {"position": 0.0, "speed": 0.0, "torque_enable": True}
    log = {
        "mass": servo["mass_kg"],
        "arm_mass": 0.0,
        "length": servo["length_m"],
        "kp": servo["firmware_gain"],
        "vin": servo["supply_V"],
        "dt": dt,
        "entries": [entry | {"goal_position": goal} for goal in goals],
    }
    with np.errstate(all="ignore"):
        angles, _, _ = Simulator(model).rollout_log(log, simulate_control=True)
    return [float(np.ravel(angle)[0]) for angle in angles]


if __name__ == "__main__":
    main()
