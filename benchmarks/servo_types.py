"""Learn the types of servos that ship, and say what a type is worth where little was recorded.

    python benchmarks/servo_types.py

Takes the recordings from SIM2REAL_REALDATA (default ../shared/realdata), writes
``sim2real/identification/types/*.json`` and ``reports/servo_types/README.md``. What is predicted is
seen neither by the fit nor by the type that it starts from.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sim2real.identification.identify import fitted_motors, identify
from sim2real.identification.servo_type import FOLDER, ServoType, learn, write_type
from sim2real.model import Model
from sim2real.recording import Recording, read_recording
from sim2real.robot import Robot, read_robot
from sim2real.servo.prediction import predict

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("SIM2REAL_REALDATA", ROOT.parent / "shared" / "realdata"))
PAGE = ROOT / "reports" / "servo_types" / "README.md"
GAINS = (200, 800)
TRAJECTORIES = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
STANDS = ("single", "nocomp2", "pgain_zero_db")
XL330_SOURCE = "8 recordings of one XL330 with a pendulum at two gains, by the BAM project"
STS3215_SOURCE = "11 servos on 3 backlash stands, by B. Kotov (Robonine); loads unknown"
PROCESSES = 2
TEXT = """# Types of servos

A prior from recordings of other servos of the same make helps where few recordings exist.
A type is a file, `identification/types/NAME.json`: for each parameter of the motor's law the middle
and the spread to expect of the next servo. `type = "NAME"` in a servo's table of `robot.toml` puts
them in the place of the general priors; `identify --together` does the same with what the other
joints of one robot tell. `python benchmarks/servo_types.py` makes the types and this page.

## XL330

Learned from {xl_source}:
**one** servo, so that the spread between servos is not seen but taken as a tenth of motor and
speed, a third of friction.

Held out: the type is learned at one gain; at the other, one recording is fitted and the three
others are predicted. Mean absolute error in mrad.

{xl}

{xl_said}

## STS3215

Learned from {sts_source}, so that
torques are per unit of what the shaft turned and help only where the load is unknown again.

Held out: the type is learned from the two other stands; of the one that is left, the first three
quarters are fitted and the last is predicted. Root mean square error in mrad.

{sts}

{sts_said}

## What the files say

{files}

The spread is of the logarithm where the parameter is searched as one (marked log).
"""


def main() -> None:
    """Learn, score, write."""
    if not REAL.is_dir():
        raise SystemExit(f"no real recordings in {REAL}; set SIM2REAL_REALDATA")
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
        xl = pool.map(xl330_line, [(g, one) for g in GAINS for one in TRAJECTORIES])
        sts = pool.map(sts3215_lines, STANDS)
        shipped = pool.submit(xl330_type, GAINS), pool.submit(sts3215_type, STANDS)
        xl_rows, sts_rows = list(xl), [row for rows in sts for row in rows]
        types = [one.result() for one in shipped]
    for one in types:
        write_type(one, FOLDER / f"{one.name}.json")
    text = TEXT.format(
        xl_source=XL330_SOURCE,
        sts_source=STS3215_SOURCE,
        xl=table(("fitted", "predicted", "general priors", "the type"), xl_rows),
        sts=table(("stand", "joint", "general priors", "the type"), sts_rows),
        xl_said=in_short(xl_rows),
        sts_said=in_short(sts_rows),
        files=table(("type", "parameter", "middle", "spread"), [r for t in types for r in said(t)]),
    )
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(text)
    print(text)


def xl330(gain: int) -> tuple[dict[str, Recording], Robot]:
    """Recordings of one gain by trajectory, and their robot."""
    folder = REAL / "bam_xl330"
    read = {t: read_recording(folder / f"xl330_kp{gain}_{t}.csv") for t in TRAJECTORIES}
    return read, read_robot(folder / "robot.toml")


def xl330_type(gains: Sequence[int]) -> ServoType:
    """The type that the recordings of some gains tell."""
    motors = []
    for gain in gains:
        recordings, robot = xl330(gain)
        motors += fitted_motors(list(recordings.values()), robot).values()
    return learn("xl330", motors, XL330_SOURCE, per_inertia=False)


def xl330_line(task: tuple[int, str]) -> tuple[str, str, float, float]:
    """Errors of the other three trajectories from one, without and with the other gain's type."""
    gain, known = task
    (other,) = (g for g in GAINS if g != gain)
    recordings, robot = xl330(gain)
    asked = [one for name, one in recordings.items() if name != known]
    errors = []
    for given in with_and_without(robot, xl330_type((other,))):
        model = identify([recordings[known], asked[0]], given, held_out=asked[0].name)
        errors.append(1e3 * float(np.mean([mean_error(model, one) for one in asked])))
    return f"gain {gain}, {known}", "the other three", errors[0], errors[1]


def mean_error(model: Model, recording: Recording) -> float:
    """Mean absolute error in rad while the torque is on."""
    joint = recording.joints[0]
    sent = {joint: recording.command[:, 0]}
    angle = predict(model, recording.t, sent, recording.loads)[joint]
    left = (angle - recording.position[:, 0])[: recording.powered(0)]
    return float(np.nanmean(np.abs(left)))


def stand(name: str) -> tuple[Recording, Robot]:
    """The recording of one stand, and its robot."""
    folder = REAL / "sts3215_backlash"
    recording = read_recording(folder / f"{name}.csv")
    kind = "single" if name == "single" else "coupled"
    return recording, read_robot(folder / f"robot_{kind}.toml")


def sts3215_type(names: Sequence[str]) -> ServoType:
    """The type that some stands tell."""
    motors = []
    for name in names:
        recording, robot = stand(name)
        motors += fitted_motors([recording], robot).values()
    return learn("sts3215", motors, STS3215_SOURCE, per_inertia=True)


def sts3215_lines(name: str) -> list[tuple[str, str, float, float]]:
    """Held-out errors of each joint of a stand, without and with the other stands' type."""
    recording, robot = stand(name)
    known = sts3215_type([other for other in STANDS if other != name])
    fits = [identify([recording], given).fit for given in with_and_without(robot, known)]
    return [
        (name, key.removesuffix(".position_rad"), heldout(fits[0], key), heldout(fits[1], key))
        for key in fits[0]
    ]


def heldout(fit: Mapping[str, Mapping[str, float | None]], key: str) -> float:
    """Held-out error in mrad."""
    return 1e3 * float(fit[key]["heldout"] or np.nan)


def with_and_without(robot: Robot, known: ServoType) -> list[Robot]:
    """The robot as it is, and one whose servos are of the type."""
    folder = TemporaryDirectory()
    KEPT.append(folder)
    path = Path(folder.name) / "type.json"
    write_type(known, path)
    joints = [replace(j, servo=replace(j.servo, type=str(path))) for j in robot.joints]
    return [robot, replace(robot, joints=tuple(joints))]


KEPT: list[TemporaryDirectory[str]] = []
"""Folders of types under test; they go with the process."""


def said(one: ServoType) -> list[tuple[str, str, str, str]]:
    """Rows of what a type says."""
    rows = []
    for name, (middle, sd) in one.parameters.items():
        log = name.endswith(("_Nm", "rad_s", "_kgm2")) and not name.endswith("coulomb_Nm")
        value = float(np.exp(middle)) if log else middle
        short = name.removeprefix("motor.")
        rows.append((one.name, short, f"{value:.3g}", f"{sd:.2g}{' log' if log else ''}"))
    return rows


def in_short(rows: Sequence[tuple[str, str, float, float]]) -> str:
    """What the type changes on average."""
    without, known = np.mean([row[2:] for row in rows], axis=0)
    better = sum(row[3] < row[2] for row in rows)
    change = 100 * (known / without - 1)
    return (
        f"On average the type changes the error by {change:+.0f} %; it is less in {better} of "
        f"{len(rows)}."
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str | float]]) -> str:
    """A Markdown table; a mean below columns of numbers."""
    cells = [[x if isinstance(x, str) else f"{x:.1f}" for x in row] for row in rows]
    numbers = [k for k in range(len(header)) if all(isinstance(row[k], float) for row in rows)]
    if numbers:
        mean = ["**mean**"] + [""] * (len(header) - 1)
        for k in numbers:
            mean[k] = f"{np.nanmean([float(row[k]) for row in rows]):.1f}"
        cells.append(mean)
    lines = [header, ["---"] * len(header), *cells]
    return "\n".join("| " + " | ".join(row) + " |" for row in lines)


if __name__ == "__main__":
    main()
