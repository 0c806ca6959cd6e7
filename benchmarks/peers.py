r"""Identify the same servos with sim2real, BAM, ``mujoco.sysid`` and by hand, side by side.

    python3.12 -m venv /tmp/bam
    /tmp/bam/bin/pip install 'better-actuator-models[identification]==1.0.2' 'optuna<4.4' numba
    python3.11 -m venv /tmp/sysid
    /tmp/sysid/bin/pip install 'mujoco[sysid]==4.0.0'
    python -m benchmarks.peers --work /tmp/peers --bam /tmp/bam/bin/python \
        --sysid /tmp/sysid/bin/python

Every method fits the same recordings and predicts recordings that it has not seen: of a real XL330
(SIM2REAL_REALDATA, default ../shared/realdata) each trajectory from the other three of its gain,
and each gain from the other; of the simulated ``datasets/servo_steps`` each recording from the
other three. Finished answers are kept in ``--work`` and not computed again. Writes
``reports/peers/``. A method whose environment is not named, and recordings that are not there, are
skipped.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.model import Model, read_model
from sim2real.output import write_json
from sim2real.recording import PER_INERTIA, Recording, read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

ROOT = Path(__file__).resolve().parents[1]
REAL = Path(os.environ.get("SIM2REAL_REALDATA", ROOT.parent / "shared" / "realdata"))
XL330, SIMULATED = REAL / "bam_xl330", ROOT / "datasets" / "servo_steps"
REPORT = ROOT / "reports" / "peers"
GAINS = (200, 800)
TRAJECTORIES = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
SIGNALS = ("chirp", "sine", "square", "steps")
BAM_MODELS = ("m1", "m2", "m3", "m4", "m5", "m6")
BAM_OWN = "bam_published_m6"
METHODS = ("sim2real", "hand", "position", "dcmotor", *(f"bam_{m}" for m in BAM_MODELS), BAM_OWN)


@dataclass(frozen=True)
class Fold:
    """What to fit and what to predict.

    Attributes:
        name: Name of the fold, for files.
        protocol: ``"within"`` one gain, ``"across"`` the gains, or ``"simulated"``.
        fit: Recordings to fit.
        score: Recordings to predict.
        kp_ratio: Known ratio of the firmware gains of ``score`` and ``fit``.
    """

    name: str
    protocol: str
    fit: tuple[Path, ...]
    score: tuple[Path, ...]
    kp_ratio: float = 1.0


@dataclass(frozen=True)
class Options:
    """Where the other environments are and how long BAM may search."""

    bam: Path | None
    sysid: Path | None
    work: Path
    trials: int


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    made.add_argument("--bam", type=Path, help="Python of an environment with BAM")
    made.add_argument("--sysid", type=Path, help="Python of an environment with mujoco[sysid]")
    made.add_argument("--work", type=Path, required=True, help="folder for finished answers")
    made.add_argument("--trials", type=int, default=100_000, help="trials of each fit by BAM")
    made.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    made.add_argument("--folds", nargs="+", default=[f.name for f in folds()], metavar="FOLD")
    made.add_argument("--no-page", action="store_true", help="compute answers only")
    return made


def main() -> None:
    """Run what is not done yet and write the report."""
    asked = parser().parse_args()
    options = Options(asked.bam, asked.sysid, asked.work, asked.trials)
    options.work.mkdir(parents=True, exist_ok=True)
    if not XL330.is_dir():
        print(f"no real recordings in {XL330}; set SIM2REAL_REALDATA")
    known = {fold.name: fold for fold in folds()}
    for fold in map(known.__getitem__, asked.folds):
        for method in asked.methods:
            path = answer_path(options.work, fold, method)
            if not path.is_file() and able(method, fold, options):
                write_json(path, answer(method, fold, options))
                print(f"{path.stem}: {json.loads(path.read_text())['mae_rad']}", flush=True)
    if not asked.no_page:
        from benchmarks.peers_page import write_report

        write_report(options.work, list(folds()))


def folds() -> Iterator[Fold]:
    """Every fold whose recordings are there."""
    if XL330.is_dir():
        for gain in GAINS:
            for left_out in TRAJECTORIES:
                known = tuple(_real(gain, name) for name in TRAJECTORIES if name != left_out)
                yield Fold(f"kp{gain}_{left_out}", "within", known, (_real(gain, left_out),))
        for gain, other in (GAINS, GAINS[::-1]):
            known = tuple(_real(gain, name) for name in TRAJECTORIES)
            asked = tuple(_real(other, name) for name in TRAJECTORIES)
            yield Fold(f"kp{gain}_to_kp{other}", "across", known, asked, other / gain)
    for left_out in SIGNALS:
        known = tuple(SIMULATED / f"{name}.csv" for name in SIGNALS if name != left_out)
        yield Fold(f"simulated_{left_out}", "simulated", known, (SIMULATED / f"{left_out}.csv",))


def _real(gain: int, trajectory: str) -> Path:
    return XL330 / f"xl330_kp{gain}_{trajectory}.csv"


def answer_path(work: Path, fold: Fold, method: str) -> Path:
    """Where the answer of a method to a fold is kept."""
    return work / f"{fold.name}-{method}.json"


def able(method: str, fold: Fold, options: Options) -> bool:
    """Whether a method can be run on a fold."""
    if method.startswith("bam"):
        return options.bam is not None and fold.protocol != "simulated"
    return method == "sim2real" or options.sysid is not None


def answer(method: str, fold: Fold, options: Options) -> dict[str, Any]:
    """Fit and predict; errors by recording and joint, and the time it took."""
    wall, cpu = time.perf_counter(), _children_cpu_s()
    found = _identified(fold, options) if method == "sim2real" else _other(method, fold, options)
    errors = {
        f"{recording.name}.{joint}": np.array(found["predictions"][joint][recording.name])
        - recording.position[: recording.powered(index), index]
        for recording in map(read_recording, fold.score)
        for index, joint in enumerate(recording.joints)
    }
    return found | {
        "mae_rad": {name: float(np.nanmean(np.abs(e))) for name, e in errors.items()},
        "rmse_rad": {name: float(np.sqrt(np.nanmean(e**2))) for name, e in errors.items()},
        "wall_s": time.perf_counter() - wall,
        "cpu_s": _children_cpu_s() - cpu,
    }


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _run(command: Sequence[str | Path]) -> None:
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [str(word) for word in command], env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.returncode}\n{done.stderr[-2000:]}")


def _identified(fold: Fold, options: Options) -> dict[str, Any]:
    """``sim2real identify`` with no option but what to hold out (which it does not fit)."""
    out = options.work / f"{fold.name}-model.json"
    given = [*fold.fit, fold.score[0]]
    robot = given[0].parent / "robot.toml"
    identify = (sys.executable, "-m", "sim2real", "identify", "--no-plots")
    options_given = ("--robot", robot, "--out", out, "--held-out", fold.score[0].stem)
    _run([*identify, *options_given, *given])
    model = _at_gain(read_model(out), fold.kp_ratio)
    predictions: dict[str, dict[str, list[float]]] = {joint: {} for joint in model.joints}
    for recording in map(read_recording, fold.score):
        sent = {joint: recording.command[:, i] for i, joint in enumerate(recording.joints)}
        angles = predict(model, recording.t, sent, recording.loads)
        for index, joint in enumerate(recording.joints):
            powered = angles[joint][: recording.powered(index)]
            predictions[joint][recording.name] = powered.tolist()
    joints = json.loads(out.read_text())["joints"]
    return {"predictions": predictions, "parameters": joints}


def _at_gain(model: Model, ratio: float) -> Model:
    """The model at another firmware gain; all else stays, in physical units."""
    joints = {
        name: replace(joint, kp_Nm_per_rad=ratio * joint.kp_Nm_per_rad)
        for name, joint in model.joints.items()
    }
    return replace(model, joints=joints)


def _other(method: str, fold: Fold, options: Options) -> dict[str, Any]:
    """Run a method in its own environment, joint by joint."""
    bam = method.startswith("bam")
    python, script = (options.bam, "peers_bam.py") if bam else (options.sysid, "peers_mujoco.py")
    assert python is not None
    found: dict[str, Any] = {}
    for index, joint in enumerate(read_recording(fold.fit[0]).joints):
        stem = f"{fold.name}-{method}-{joint}"
        job, out = options.work / f"{stem}-job.json", options.work / f"{stem}-out.json"
        write_json(job, _job(method, fold, index, options))
        _run([python, ROOT / "benchmarks" / script, job, out])
        for key, value in json.loads(out.read_text()).items():
            found.setdefault(key, {})[joint] = value
    return found


def _job(method: str, fold: Fold, index: int, options: Options) -> dict[str, Any]:
    """All that a method may know: recordings, loads, data sheet and firmware gains."""
    robot = read_robot(fold.fit[0].parent / "robot.toml")
    servo = robot.joints[index].servo
    job = {
        "method": method,
        "fit": [_plain(read_recording(path), index) for path in fold.fit],
        "score": [_plain(read_recording(path), index) for path in fold.score],
        "kp_ratio": fold.kp_ratio,
        "max_torque_Nm": servo.max_torque_Nm,
        "no_load_speed_rad_s": servo.no_load_speed_rad_s,
    }
    if method.startswith("bam"):
        published = method == BAM_OWN
        job |= {"model": method[-2:], "published": published, "seed": 0}
        job["trials"] = 0 if published else options.trials
    return job


def _plain(recording: Recording, index: int) -> dict[str, Any]:
    """One joint of a recording in plain numbers, for another environment.

    After the torque is switched off the last command is repeated; ``powered`` counts the samples
    before that.
    """
    joint, powered = recording.joints[index], recording.powered(index)
    load = recording.loads.get(joint, PER_INERTIA)
    command = recording.command[:, index].copy()
    command[powered:] = command[powered - 1]
    speed = recording.columns.get(f"{joint}.velocity_rad_s", np.zeros_like(recording.t))
    return {
        "name": recording.name,
        "t_s": recording.t.tolist(),
        "command_rad": command.tolist(),
        "position_rad": _or_none(recording.position[:, index]),
        "velocity_rad_s": speed.tolist(),
        "powered": powered,
        "inertia_kgm2": load.inertia_kgm2,
        "pendulum_mass_kg": load.pendulum_mass_kg,
        "pendulum_length_m": load.pendulum_length_m,
        "firmware_gain": recording.metadata.get("firmware_p_gain"),
        "supply_V": recording.metadata.get("supply_nominal_V"),
    }


def _or_none(values: Array) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


if __name__ == "__main__":
    main()
