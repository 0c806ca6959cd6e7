"""Models to export, and how they are exported by the command line."""

from importlib.util import find_spec

import numpy as np
import pytest
import simulated

from sim2real.cli import main
from sim2real.effects import CATALOGUE
from sim2real.model import FittedEffect, JointModel, Model, write_model
from sim2real.recording import Load, write_recording

Effects = dict[str, float]
TYPICAL = {e.name: {p.name: p.typical for p in e.parameters} for e in CATALOGUE}
for train in ("backlash", "compliance"):  # as targets have them
    TYPICAL[train]["control_on_output"] = 0.0
TYPICAL["backlash"]["restitution"] = 0.0
TYPICAL["deadband"]["step_share"] = TYPICAL["load_friction"]["fading_s_per_rad"] = 0.0
needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="MuJoCo runs exported models")


def typical(*names):
    """Effects with typical parameters, as ``servo`` takes them."""
    return {name: TYPICAL[name] for name in names}


def joint(load=None, motor=None, latency_s=simulated.LATENCY, kd=simulated.KD, **effects):
    load = load or Load(simulated.INERTIA)
    fitted = tuple(FittedEffect(name, values) for name, values in effects.items())
    return JointModel(
        simulated.KP, kd, latency_s, load.inertia_kgm2, law="motor" if motor else "pd",
        motor=motor or {}, load=load, effects=fitted,
    )  # fmt: skip


def servo(*given, **more):
    """A model of one joint; the arguments are those of ``joint``."""
    return Model({"j1": joint(*given, **more)})


def rms(difference):
    return float(np.sqrt(np.mean(difference**2)))


def export(folder, model, recordings, target, *more):
    """The status of ``export-servo`` into ``folder/servo.txt``, refitted to recordings."""
    paths = [folder / f"{recording.name}.csv" for recording in recordings]
    for path, recording in zip(paths, recordings, strict=True):
        write_recording(recording, path)
    write_model(model, folder / "model.json")
    out = ["--to", target, "--out", str(folder / "servo.txt")]
    given = ["--recordings", *map(str, paths)]
    return main(["export-servo", str(folder / "model.json"), *out, *given, *more])
