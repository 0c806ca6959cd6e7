"""How well servos identified from real recordings predict others: prints the tables of the reports.

    python -m benchmarks.real_servos [--part alone within across emps] [--seeds 0 1 2 3]
    python -m benchmarks.real_servos --part within across --diagnose     # much longer

``alone``: each log, its last quarter held out. ``within``: of an XL330 with a pendulum, each
trajectory of a firmware gain from the other three. ``across``: all of one gain from those of the
other, kp scaled by the known ratio of the two. ``emps``: a drive whose controller is published, its
metres read as radians. What is predicted is seen by no fit. ``--diagnose`` adds the model that a
diagnosis of the fitted recordings returns.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.harness import command_line, real_recordings, spread, table
from sim2real.arrays import Array
from sim2real.diagnose.diagnose import Case, diagnose_case
from sim2real.identification.identify import identify
from sim2real.model import Law, Model
from sim2real.recording import Recording, read_recording
from sim2real.robot import Joint, Link, Robot, Servo, read_robot
from sim2real.servo.prediction import predict

GAINS = (200, 800)
TRAJECTORIES = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
HAND_PICKED = ("load_friction", "unmodelled_inertia", "torque_saturation")
LAWS = {"pd": "linear", "motor": "motor", "current_limited": "motor limited in current"}
ASKED: tuple[Law, ...] = ("pd", "motor")
MASS_KG, VISCOUS, COULOMB_N = 95.109, 203.50, 20.394
"""Of EMPS, in kg, N s/m and N: Janot, Gautier, Brunot (2019), least squares."""


@dataclass(frozen=True)
class Task:
    """What to learn from, by firmware gain and trajectories, and what to predict."""

    gain: int
    known: tuple[str, ...]
    asked_gain: int
    asked: tuple[str, ...]


WITHIN = [
    Task(gain, tuple(t for t in TRAJECTORIES if t != one), gain, (one,))
    for gain in GAINS
    for one in TRAJECTORIES
]
ACROSS = [Task(gain, TRAJECTORIES, other, TRAJECTORIES) for gain, other in (GAINS, GAINS[::-1])]


def read(gain: int, trajectories: Sequence[str]) -> list[Recording]:
    """The XL330's recordings of one firmware gain."""
    folder = real_recordings() / "bam_xl330"
    return [read_recording(folder / f"xl330_kp{gain}_{name}.csv") for name in trajectories]


def residuals(model: Model, recording: Recording, kp_ratio: float = 1.0) -> Array:
    """Simulated minus measured angles in rad while the torque is on, at another firmware gain."""
    (joint,) = recording.joints
    servo = model.joints[joint]
    scaled = replace(servo, kp_Nm_per_rad=kp_ratio * servo.kp_Nm_per_rad)
    model, sent = replace(model, joints={joint: scaled}), {joint: recording.command[:, 0]}
    angle = predict(model, recording.t, sent, recording.loads)[joint]
    left: Array = (angle - recording.position[:, 0])[: recording.powered(0)]
    return left[np.isfinite(left)]


def answer(task: Task, seed: int = 0, *, diagnosed: bool = False) -> Array:
    """Mean absolute and RMS errors in mrad, shape (2, asked, models).

    One recording that is asked for is handed over as the one to hold out, so that all others are
    fitted.
    """
    robot = read_robot(real_recordings() / "bam_xl330" / "robot.toml")
    known = read(task.gain, task.known)
    asked = read(task.asked_gain, task.asked)
    given = [*known, asked[0]]
    choices: list[tuple[Law, tuple[str, ...]]] = [("pd", ()), ("pd", HAND_PICKED), ("motor", ())]
    models = [
        identify(given, robot, held_out=asked[0].name, law=law, effects=effects, seed=seed)
        for law, effects in choices
    ]
    if diagnosed:
        models.append(diagnose_case(Case(known, robot, models[-1])).model)
    ratio = task.asked_gain / task.gain
    errors = [[residuals(model, one, ratio) for model in models] for one in asked]
    mae = [[np.mean(np.abs(e)) for e in row] for row in errors]
    rmse = [[np.sqrt(np.mean(e**2)) for e in row] for row in errors]
    return 1e3 * np.array([mae, rmse])


def predicted(tasks: Sequence[Task], seeds: Sequence[int], *, diagnosed: bool) -> None:
    """Print the errors by trajectory and model, of the first seed, and how far they are luck."""
    names = ["linear", "with three effects picked by hand", "motor"]
    names += ["as diagnosed"] if diagnosed else []
    rows, luck = [], []
    for seed in seeds:
        work = partial(answer, seed=seed, diagnosed=diagnosed)
        answers = list(spread(work, tasks, 2, unit="fit"))
        mae, rmse = np.concatenate(answers, axis=1)
        luck.append((str(seed), f"{mae[:, 2].mean():.1f}", f"{rmse[:, 2].max():.1f}"))
        if seed == seeds[0]:
            asked = [f"gain {task.asked_gain}, {name}" for task in tasks for name in task.asked]
            errors = np.concatenate([mae, rmse], axis=1)
            errors = np.concatenate([errors, errors.mean(axis=0, keepdims=True)])
            rows = [
                (name, *(f"{x:.1f}" for x in row))
                for name, row in zip([*asked, "**mean**"], errors, strict=True)
            ]
    print(table(["predicted (mrad)", *names, *(f"RMSE, {name}" for name in names)], rows))
    print("\nthe motor's law by the seed of its search\n")
    print(table(("seed", "mean absolute error (mrad)", "largest RMSE (mrad)"), luck))


def logs() -> Iterator[tuple[Path, Path]]:
    """Every log that has commands, with its robot file."""
    for path in sorted(real_recordings().glob("*/*.csv")):
        sidecar = json.loads(path.with_suffix(".json").read_text())
        if sidecar.get("kind") == "servo":
            yield path, path.parent / sidecar.get("robot", "robot.toml")


def alone() -> None:
    """Print a row for each log, joint and law."""
    rows = []
    for path, robot in logs():
        for law in ASKED:
            model = identify([read_recording(path)], read_robot(robot), law=law)
            for joint, servo in model.joints.items():
                fit = model.fit[f"{joint}.position_rad"]
                errors = (f"{1e3 * (fit[k] or np.nan):.2f}" for k in ("train", "heldout", "noise"))
                gains = f"{servo.kp_Nm_per_rad:.4g}", f"{servo.kd_Nms_per_rad:.4g}"
                late = f"{1e3 * servo.latency_s:.1f}"
                lag = f"{fit['whiteness']:.3f}"
                rows.append((path.stem, joint, LAWS[servo.law], *errors, lag, *gains, late))
    header = (
        "recording", "joint", "law", "fitted RMSE (mrad)", "held-out RMSE (mrad)", "noise (mrad)",
        "lag-1 autocorrelation", "kp", "kd", "latency (ms)",
    )  # fmt: skip
    print(table(header, rows))


def emps_drive(folder: Path) -> tuple[Recording, Robot]:
    """The EMPS drive and its recording, whose metres are read as radians."""
    data = pd.read_csv(folder / "emps.csv")
    t, sent = data["t_s"].to_numpy(), data[["reference_m"]].to_numpy()
    link = Link("carriage", MASS_KG, 1.0, 1.0, 1.0)
    robot = Robot("EMPS", (link, link), (Joint("j1", Servo("drive", 400.0, 10.0, 0.0), (-1, 1)),))
    return Recording("emps", "servo", ("j1",), t, sent, data[["position_m"]].to_numpy()), robot


def emps() -> None:
    """Print the gains of the EMPS drive per unit of mass beside the published ones."""
    about = json.loads((real_recordings() / "emps" / "emps.json").read_text())
    control, gain = about["controller"], about["drive_gain_N_per_V"]
    kp = gain * control["kp_per_s"] * control["kv_V_s_per_m"] / MASS_KG
    kd = (gain * control["kv_V_s_per_m"] + VISCOUS) / MASS_KG
    recording, robot = emps_drive(real_recordings() / "emps")
    rows = [("published", f"{kp:.4g}", f"{kd:.4g}", "", f"{COULOMB_N / MASS_KG:.3f}", "", "")]
    for law, effects in (("pd", ()), ("pd", ("coulomb_friction",)), ("motor", ())):
        model = identify([recording], robot, effects=effects, law=law)
        servo, fit = model.joints["j1"], model.fit["j1.position_rad"]
        found = {**servo.motor, **(servo.effects[0].parameters if servo.effects else {})}
        friction = found.get("torque_Nm", found.get("coulomb_Nm"))
        off = [servo.kp_Nm_per_rad / kp, servo.kd_Nms_per_rad / kd]
        gains = f"{servo.kp_Nm_per_rad:.4g}", f"{servo.kd_Nms_per_rad:.4g}"
        rows.append((
            " + ".join((LAWS[law], *effects)),
            *(f"{x} ({100 * (y - 1):+.0f} %)" for x, y in zip(gains, off, strict=True)),
            f"{1e3 * servo.latency_s:.2f}",
            "" if friction is None else f"{friction:.3f}",
            *(f"{1e6 * (fit[key] or np.nan):.1f}" for key in ("train", "heldout")),
        ))  # fmt: skip
    header = (
        "", "kp / mass (1/s2)", "kd / mass (1/s)", "latency (ms)", "friction / mass (N/kg)",
        "fitted RMSE (um)", "held-out RMSE (um)",
    )  # fmt: skip
    print(table(header, rows))


def main() -> None:
    """Print the tables."""
    parser = command_line(__doc__, seeds=[0], diagnose=(False, "also the model of a diagnosis"))
    parts = ("alone", "within", "across", "emps")
    parser.add_argument("--part", nargs="+", choices=parts, default=parts)
    options = parser.parse_args()
    real_recordings()
    for part in options.part:
        print(f"\n{part}\n")
        if part in ("within", "across"):
            tasks = WITHIN if part == "within" else ACROSS
            predicted(tasks, options.seeds, diagnosed=options.diagnose)
        else:
            (alone if part == "alone" else emps)()


if __name__ == "__main__":
    main()
