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

from sim2real.identification.identify import identify
from sim2real.model import Law, Model
from sim2real.recording import Recording, read_recording
from sim2real.robot import Joint, Link, Robot, Servo, read_robot

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("SIM2REAL_REALDATA", ROOT.parent / "shared" / "realdata"))
HEADER = (
    "recording", "joint", "law", "fitted RMSE (mrad)", "held-out RMSE (mrad)", "noise (mrad)",
    "lag-1 autocorrelation", "kp", "kd", "latency (ms)",
)  # fmt: skip
EMPS_HEADER = (
    "", "kp / mass (1/s2)", "kd / mass (1/s)", "latency (ms)", "friction / mass (N/kg)",
    "fitted RMSE (um)", "held-out RMSE (um)",
)  # fmt: skip
HAND_PICKED = ("load_friction", "unmodelled_inertia", "torque_saturation")
LAWS = {"pd": "linear", "motor": "motor", "current_limited": "motor limited in current"}
ASKED: tuple[Law, ...] = ("pd", "motor")
TEXT = """# Real servos

## One recording alone

One line for each joint that moves and each law: `sim2real identify RECORDING --robot robot.toml`,
and the same with `--law pd`. The last quarter of each recording is held out. RMSE is the root mean
square error; noise is the floor set by the sensor; the lag-1 autocorrelation of the residual is 0
for white noise. Gains of the XL330 are in N m/rad and N m s/rad, all others per unit of inertia
(1/s2, 1/s), as no load is known.

**A linear servo does not fit these servos.** Its residual stands above the noise, on the XL330 14
to 170 times. A motor on the line of its data sheet, whose gears rub, fits the XL330 several times
better; what that is worth on recordings of other motions is below and in [the diagnosis of a real
servo](real_diagnosis.md). The STS3215 moves on profiles of its own and is sampled ten times a
second: there the law changes little, and what is missing is the profile.

{table}

## Each trajectory from the others

All trajectories of one firmware gain fitted together, each held out in turn (torque-on part): as a
linear servo, with inertia left out by the load, with three effects picked by hand (`--effects`),
the best of six sets tried on these very logs; and by the motor's law, for which nothing is picked.

{together}

## A drive whose controller is known

EMPS is a linear drive, not a servo in the recording format; here its metres are read as radians.
Its published controller and inertial parameters give the gains per unit of mass, so this is the one
real recording where the answer is known.

{emps}

The linear fit bends both gains. With friction it comes out near the published one, held-out error
falls, and a part of the bend in kp goes; what bends it still is not known.

## What is not here

`fishsim` has no commands: `identify` refuses it in one line. Sources and licences of the recordings
are in their folder.
"""


def main() -> None:
    """Write the report, and print it."""
    if not REAL.is_dir():
        raise SystemExit(f"no real recordings in {REAL}; set SIM2REAL_REALDATA")
    rows = [
        row
        for path, robot in logs()
        for law in ASKED
        for row in lines(path.stem, fitted([path], robot, law))
    ]
    text = TEXT.format(table=table(HEADER, rows), together=together(), emps=emps())
    (ROOT / "reports" / "real_servos.md").write_text(text)
    print(text)


def logs() -> Iterator[tuple[Path, Path]]:
    """Every log that has commands, with its robot file."""
    for path in sorted(REAL.glob("*/*.csv")):
        sidecar = json.loads(path.with_suffix(".json").read_text())
        if sidecar.get("kind") == "servo":
            yield path, path.parent / sidecar.get("robot", "robot.toml")


def fitted(paths: list[Path], robot: Path, law: Law) -> Model:
    """Identify, with no option but the law."""
    return identify([read_recording(path) for path in paths], read_robot(robot), law=law)


def lines(name: str, model: Model) -> Iterator[tuple[str, ...]]:
    """One row of the table for each joint."""
    for joint, servo in model.joints.items():
        figures = model.fit[f"{joint}.position_rad"]
        yield (
            name,
            joint,
            LAWS[servo.law],
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
            for effects in ((), ("unmodelled_inertia",), HAND_PICKED, None):
                law: Law = "motor" if effects is None else "pd"
                chosen = effects or ()
                model = identify(
                    recordings, robot, held_out=path.stem, refit=False, effects=chosen, law=law
                )
                row = next(iter(lines(path.stem, model)))
                rows.append((*row[:1], " + ".join(chosen) or LAWS[law], *row[3:]))
    return table((HEADER[0], "model", *HEADER[3:]), rows)


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
    for effects in ((), ("coulomb_friction",), None):
        law: Law = "motor" if effects is None else "pd"
        model = identify([recording], robot, effects=effects or (), law=law)
        servo, figures = model.joints["j1"], model.fit["j1.position_rad"]
        friction = [
            f"{e.parameters['torque_Nm']:.3f}" for e in servo.effects if "torque_Nm" in e.parameters
        ]
        if "coulomb_Nm" in servo.motor:
            friction = [f"{servo.motor['coulomb_Nm']:.3f}"]
        rows.append(
            (
                " + ".join((LAWS[law], *(effects or ()))),
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
