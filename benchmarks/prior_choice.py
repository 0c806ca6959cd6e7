"""Choose the spreads of the motor's prior on one gain of an XL330, and score them on the other.

    python benchmarks/prior_choice.py

For each gain, every setting is judged by leaving each of its trajectories out in turn. The best one
predicts the other gain: each trajectory from the other three there, and all of it from the first
gain. So no scored error has been seen by the choice. Takes the recordings from SIM2REAL_REALDATA
(default ../shared/realdata), writes ``reports/prior_choice.md``.
"""

from __future__ import annotations

import itertools
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from real_diagnosis import FOLDER as BENCH
from real_diagnosis import GAINS, PROCESSES, ROOT, TRAJECTORIES, at_gain, error, read, read_robot

from sim2real.identification import motor_choice
from sim2real.identification.identify import identify
from sim2real.identification.motor_prior import MotorPrior, motor_prior

REPORT = ROOT / "reports" / "prior_choice.md"


class Spreads(NamedTuple):
    """Arguments of ``motor_prior``, by default those of ``identify``."""

    loss_width: float = 1.0
    reported_sd: float = MotorPrior.reported_sd


SHIPPED = Spreads()
SETTINGS = [
    Spreads(loss_width, reported_sd)
    for loss_width, reported_sd in itertools.product((0.5, 1.0, 2.0), (SHIPPED.reported_sd, np.inf))
]
TEXT = """# How wide a motor's prior is

`python benchmarks/prior_choice.py` makes this page. Spreads of losses and friction are multiplied
by a factor, and the drive that the servo reports is used or not: six settings. Each is judged on
one firmware gain of an XL330, by leaving each of its four trajectories out in turn; the best one
then predicts the other gain. **No scored error has been seen by the choice.** Mean absolute errors
in mrad.

{table}

| | chosen on the other gain | {shipped} |
| --- | --- | --- |
| each trajectory from the other three of its gain | {within} | {within_shipped} |
| each gain from the other | {across} | {across_shipped} |

Chosen on gain 200: {chosen_200}; on gain 800: {chosen_800}. One gain hardly tells the settings
apart, and their predictions differ. So `identify` keeps the spreads of the last column,
with the drive wherever a servo reports it ([what that is worth](real_diagnosis.md)).
"""

Task = tuple[int, str, Spreads]


def main() -> None:
    """Fit everything once, choose, write."""
    tasks = [(gain, out, s) for gain in GAINS for out in (*TRAJECTORIES, "") for s in SETTINGS]
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
        errors = dict(zip(tasks, pool.map(one, tasks), strict=True))

    def within(gain: int, s: Spreads) -> float:
        return float(np.mean([errors[gain, t, s] for t in TRAJECTORIES]))

    chosen = {gain: min(SETTINGS, key=lambda s: within(gain, s)) for gain in GAINS}
    other = {gain: next(g for g in GAINS if g != gain) for gain in GAINS}
    rows = [
        (said(s), *(f"{x:.1f}" for g in GAINS for x in (within(g, s), errors[other[g], "", s])))
        for s in SETTINGS
    ]
    header = ("setting", *(h for g in GAINS for h in (f"within {g}", f"{g} from {other[g]}")))
    lines = [header, ("---",) * len(header), *rows]

    def mean(of: dict[int, Spreads], across: bool) -> str:
        every = [errors[other[g], "", of[g]] if across else within(g, of[g]) for g in GAINS]
        return f"{np.mean(every):.1f}"

    told = {g: chosen[other[g]] for g in GAINS}
    shipped = dict.fromkeys(GAINS, SHIPPED)
    text = TEXT.format(
        table="\n".join("| " + " | ".join(row) + " |" for row in lines),
        shipped=said(SHIPPED),
        within=mean(told, False),
        within_shipped=mean(shipped, False),
        across=mean(told, True),
        across_shipped=mean(shipped, True),
        chosen_200=said(chosen[200]),
        chosen_800=said(chosen[800]),
    )
    REPORT.write_text(text)
    print(text)


def one(task: Task) -> float:
    """Mean absolute error in mrad: of what is left out, or of the other gain where nothing is."""
    gain, out, spreads = task
    motor_choice.motor_prior = partial(motor_prior, **spreads._asdict())
    robot = read_robot(BENCH / "robot.toml")
    if out:
        known, asked = read(gain, [t for t in TRAJECTORIES if t != out]), read(gain, [out])
        ratio = 1.0
    else:
        (to,) = (g for g in GAINS if g != gain)
        known, asked, ratio = read(gain, TRAJECTORIES), read(to, TRAJECTORIES), to / gain
    model = identify([*known, asked[0]], robot, held_out=asked[0].name)
    moved = at_gain(model, ratio)
    return 1e3 * float(np.mean([np.mean(np.abs(error(moved, r))) for r in asked]))


def said(spreads: Spreads) -> str:
    """A setting in words."""
    drive = "reported drive" if np.isfinite(spreads.reported_sd) else "no reported drive"
    return f"x {spreads.loss_width:g}, {drive}"


if __name__ == "__main__":
    main()
