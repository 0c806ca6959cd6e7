"""Fit a plain PD servo to real recordings and say how badly that goes.

    python benchmarks/real_servos.py

Takes the folder of real recordings from SIM2REAL_REALDATA (default ../shared/realdata) and writes
``reports/real_servos.md``. Every log is identified with no option but its robot file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from sim2real.model import Model
from sim2real.recording import Recording, read_recording
from sim2real.robot import Joint, Link, Robot, Servo, read_robot
from sim2real.servo.identify import identify

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("SIM2REAL_REALDATA", ROOT.parent / "shared" / "realdata"))
HEADER = (
    "recording", "joint", "fitted RMSE (mrad)", "held-out RMSE (mrad)", "noise (mrad)",
    "lag-1 autocorrelation", "kp", "kd", "latency (ms)",
)  # fmt: skip
EMPS_HEADER = (
    "", "kp / mass (1/s2)", "kd / mass (1/s)", "latency (ms)", "friction / mass (N/kg)",
    "fitted RMSE (um)", "held-out RMSE (um)",
)  # fmt: skip
HAND_PICKED = ("load_friction", "unmodelled_inertia", "torque_saturation")
TEXT = """# Real servos

## A plain PD model

One line for each joint that moves: `sim2real identify RECORDING --robot robot.toml`, nothing else.
The last quarter of each recording is held out. RMSE is the root mean square error; noise is the
floor set by the sensor; the lag-1 autocorrelation of the residual is 0 for white noise. Gains of
the XL330 are in N m/rad and N m s/rad, all others per unit of inertia (1/s2, 1/s), as no load is
known.

**A plain PD servo does not fit these servos.** The residual stands above the noise, on the XL330 14
to 170 times, and is correlated in time: physics is missing (friction that grows with load, limits
of torque and speed, profiles inside the servo, inertia left out). The parameters below are what
best imitates that, not properties of the servos.

{table}

## Each trajectory from the others

All trajectories of one firmware gain fitted together, each held out in turn (torque-on part): as a
plain servo, with inertia left out by the load, and with three effects picked by hand (`--effects`).
The three are the best of six sets tried on these very logs, so the choice has seen what is held out
here, though the fit has not. Picking them from the data alone is another matter.

{together}

## A drive whose controller is known

EMPS is a linear drive, not a servo in the recording format; here its metres are read as radians.
Its published controller and inertial parameters give the gains per unit of mass, so this is the one
real recording where the answer is known.

{emps}

The plain fit bends both gains. With Coulomb friction the friction comes out near the published one,
held-out error falls, and a part of the bend in kp goes; what bends it still is not known.

## What is not here

`fishsim` has no commands: `identify` refuses it in one line. Sources and licences of the recordings
stand beside them.
"""


def main() -> None:
    """Write the report, and print it."""
    if not REAL.is_dir():
        raise SystemExit(f"no real recordings in {REAL}; set SIM2REAL_REALDATA")
    rows = [row for path, robot in logs() for row in lines(path.stem, fitted([path], robot))]
    text = TEXT.format(table=table(HEADER, rows), together=together(), emps=emps())
    (ROOT / "reports" / "real_servos.md").write_text(text)
    print(text)


def logs() -> Iterator[tuple[Path, Path]]:
    """Every log that has commands, with its robot file."""
    for path in sorted(REAL.glob("*/*.csv")):
        sidecar = json.loads(path.with_suffix(".json").read_text())
        if sidecar.get("kind") == "servo":
            yield path, path.parent / sidecar.get("robot", "robot.toml")


def fitted(paths: list[Path], robot: Path, held_out: str | None = None) -> Model:
    """Identify, with no option but what is held out."""
    recordings = [read_recording(path) for path in paths]
    return identify(recordings, read_robot(robot), held_out=held_out)


def lines(name: str, model: Model) -> Iterator[tuple[str, ...]]:
    """One row of the table for each joint."""
    for joint, servo in model.joints.items():
        figures = model.fit[f"{joint}.position_rad"]
        yield (
            name,
            joint,
            *(f"{1e3 * (figures[key] or np.nan):.2f}" for key in ("train", "heldout", "noise")),
            f"{figures['whiteness']:.3f}",
            f"{servo.kp_Nm_per_rad:.4g}",
            f"{servo.kd_Nms_per_rad:.4g}",
            f"{1e3 * servo.latency_s:.1f}",
        )


def together() -> str:
    """The XL330's trajectories of one gain, each held out in turn, plain and with effects."""
    rows = []
    folder = REAL / "bam_xl330"
    for gain in (200, 800):
        paths = sorted(folder.glob(f"xl330_kp{gain}_*.csv"))
        for path in paths:
            recordings = [read_recording(p) for p in paths]
            robot = read_robot(folder / "robot.toml")
            for effects in ((), ("unmodelled_inertia",), HAND_PICKED):
                model = identify(recordings, robot, held_out=path.stem, effects=effects)
                row = next(iter(lines(path.stem, model)))
                rows.append((*row[:1], " + ".join(effects) or "plain", *row[2:]))
    return table((HEADER[0], "model", *HEADER[2:]), rows)


def emps() -> str:
    """The EMPS drive, its gains per unit of mass beside the published ones."""
    data = pd.read_csv(REAL / "emps" / "emps.csv")
    about = json.loads((REAL / "emps" / "emps.json").read_text())
    control, gain = about["controller"], about["drive_gain_N_per_V"]
    mass, viscous = 95.109, 203.50  # kg, N s/m: Janot, Gautier, Brunot (2019), least squares
    kp = gain * control["kp_per_s"] * control["kv_V_s_per_m"] / mass
    kd = (gain * control["kv_V_s_per_m"] + viscous) / mass
    recording = Recording(
        name="emps",
        kind="servo",
        joints=("j1",),
        t=data["t_s"].to_numpy(),
        command=data[["reference_m"]].to_numpy(),
        position=data[["position_m"]].to_numpy(),
    )
    link = Link("carriage", mass, 1.0, 1.0, 1.0)
    joint = Joint("j1", Servo("drive", 400.0, 10.0, 0.0), (-1.0, 1.0))
    robot = Robot("EMPS", (link, link), (joint,))
    published = (f"{kp:.4g}", f"{kd:.4g}", "none stated", f"{20.394 / mass:.3f}")
    rows = [("published", *published, "", "")]
    for effects in ((), ("coulomb_friction",)):
        model = identify([recording], robot, effects=effects)
        servo, figures = model.joints["j1"], model.fit["j1.position_rad"]
        friction = [f"{e.parameters['torque_Nm']:.3f}" for e in servo.effects]
        rows.append(
            (
                " + ".join(("plain", *effects)),
                f"{servo.kp_Nm_per_rad:.4g} ({100 * (servo.kp_Nm_per_rad / kp - 1):+.0f} %)",
                f"{servo.kd_Nms_per_rad:.4g} ({100 * (servo.kd_Nms_per_rad / kd - 1):+.0f} %)",
                f"{1e3 * servo.latency_s:.2f}",
                friction[0] if friction else "",
                *(f"{1e6 * (figures[key] or np.nan):.1f}" for key in ("train", "heldout")),
            )
        )
    return table(EMPS_HEADER, rows)


def table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    cells = [header, ("---",) * len(header), *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


if __name__ == "__main__":
    main()
