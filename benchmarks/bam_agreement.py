"""How far a servo imported from BAM's parameters is from BAM's own simulator.

    python3.12 -m venv /tmp/bam && /tmp/bam/bin/pip install better-actuator-models==1.0.2
    python -m benchmarks.bam_agreement /tmp/bam/bin/python

Every servo and friction model (M1 to M6) of BAM's release, on a pendulum of a third of its stall
torque, for random steps and a sine that quickens to 2 Hz. BAM integrates by Euler's method, here
with a time step of 0.25 ms, so that what is printed is the difference of the models.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import command_line
from sim2real.arrays import Array
from sim2real.importers.bam import read_bam_parameters
from sim2real.model import Model
from sim2real.recording import GRAVITY_M_S2, Load
from sim2real.servo.prediction import predict

DT_S, SECONDS = 0.00025, 8.0
LENGTH_M = 0.15
SCRIPT = Path(__file__).with_name("bam_rollout.py")


def signals() -> tuple[Array, dict[str, Array]]:
    """Times in s, shape (T,), and set-points in rad by name."""
    t = DT_S * np.arange(round(SECONDS / DT_S))
    rng = np.random.default_rng(5)
    moves = 0.3 + np.cumsum(rng.uniform(0.3, 0.9, 40))
    levels = np.concatenate([[0.0], rng.uniform(-0.8, 0.8, 40)])
    s = np.maximum(t - 0.3, 0.0)
    sine = 0.6 * np.sin(2 * np.pi * (0.2 + 0.9 * s / s[-1]) * s)
    return t, {"steps": levels[np.searchsorted(moves, t, side="right")], "sine": sine}


def ask(python: str, job: dict[str, Any]) -> dict[str, Any]:
    """The answer of ``bam_rollout.py`` in BAM's environment."""
    with tempfile.TemporaryDirectory() as folder:
        source, out = Path(folder, "job.json"), Path(folder, "answer.json")
        source.write_text(json.dumps(job))
        subprocess.run([python, str(SCRIPT), str(source), str(out)], check=True)
        answer: dict[str, Any] = json.loads(out.read_text())
        return answer


def imported(parameters: dict[str, Any], length_m: float, mass_kg: float | None = None) -> Model:
    """The model of a parameter file on a pendulum, of a third of the stall torque where None."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "parameters.json")
        path.write_text(json.dumps(parameters))
        if mass_kg is None:
            stall = read_bam_parameters(path, Load(1.0)).joints["j1"].motor["stall_torque_Nm"]
            mass_kg = stall / 3 / (GRAVITY_M_S2 * length_m)
        return read_bam_parameters(path, Load(mass_kg * length_m**2, mass_kg, length_m))


def main() -> None:
    """Print a table of RMS differences in mrad."""
    parser = command_line(__doc__)
    parser.add_argument("python", help="Python of the environment that has BAM")
    python = parser.parse_args().python
    shipped = ask(python, {})
    t, sent = signals()
    models, servos = {}, {}
    for name, parameters in shipped["parameters"].items():
        if "erob" in parameters["actuator"]:
            continue
        model = models[name] = imported(parameters, LENGTH_M)
        load = model.joints["j1"].load
        assert load is not None
        bench = {"file": name, "mass_kg": load.pendulum_mass_kg, "length_m": LENGTH_M}
        servos[name] = model.provenance["servo"] | bench | {"without_offset": True}
    job = {"servos": servos, "dt_s": DT_S, "signals": {k: x.tolist() for k, x in sent.items()}}
    answer = ask(python, job)
    print(f"better-actuator-models {shipped['version']}; mrad RMS, motion itself in brackets")
    print(f"{'servo':<26}" + "".join(f"{kind:>18}" for kind in sent))
    for name, model in models.items():
        cells = []
        for kind, command in sent.items():
            theirs = np.array(answer[name][kind])
            ours = predict(model, t, {"j1": command})["j1"]
            apart = 1e3 * np.sqrt(np.mean((ours - theirs) ** 2))
            cells.append(f"{apart:9.2f} ({1e3 * theirs.std():5.0f})")
        print(f"{name:<26}" + "".join(f"{cell:>18}" for cell in cells))


if __name__ == "__main__":
    main()
