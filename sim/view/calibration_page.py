"""A calibration of the body as a section of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.inference.calibration import Calibrated
from sim.inference.swims import HELD_OUT_SHARE, SIGNALS, UNITS, Simulator, Swim, simulated
from sim.view.calibration_plot import comparison_block
from sim2real.model import Model
from sim2real.report.page import Note, Section, Table
from sim2real.report.quantity import change_text
from sim2real.robot import Robot

_WORSE = 0.05
"""Relative increase of a held-out error from which the page comments on it."""
_OFFSET = 0.5
"""Share of the mean square error from which a constant offset is its main part."""
_TABLE = (
    "Root mean square error on the held-out part of the swim, size (root mean square) of the "
    "measured signal there, and change of the error on the fitted part."
)


@dataclass(frozen=True)
class SignalError:
    """Errors of one signal of a swim before and after a calibration.

    Attributes:
        name: The signal.
        unit: Its unit.
        held_out: Root mean square error on the held-out part, before and after.
        fitted: Likewise on the fitted part.
        size: Root mean square of the measured signal on the held-out part.
        offset: Mean error on the held-out part after the calibration.
    """

    name: str
    unit: str
    held_out: tuple[float, float]
    fitted: tuple[float, float]
    size: float
    offset: float

    @property
    def comment(self) -> str:
        """Explanation of an increased held-out error from its numbers; empty if it is small."""
        before, after = self.held_out
        if after <= (1 + _WORSE) * before:
            return ""
        change = change_text(*self.fitted)
        improved = self.fitted[1] < self.fitted[0]
        return " ".join(
            [
                f"{self.name}: the held-out error rises from {before:.3f} to {after:.3f} "
                f"{self.unit}, {100 * after / self.size:.0f} % of the signal's size.",
                f"On the fitted part it changes by {change}: "
                + (
                    "this improvement does not generalise to the held-out motion."
                    if improved
                    else "the fit, which weighs all signals together, gave up some of this one for "
                    "the others."
                ),
                self._kind,
            ]
        )

    @property
    def _kind(self) -> str:
        """Whether the error is an offset or varies."""
        share = (self.offset / self.held_out[1]) ** 2
        offset = (
            f"A constant offset of {self.offset:+.3f} {self.unit} accounts for {100 * share:.0f} % "
            "of the mean square error"
        )
        if share >= _OFFSET:
            return f"{offset}: a slow drift, not the beat of the tail."
        return f"{offset}: most of it varies with the motion."


def signal_errors(
    swim: Swim, calibrated: Calibrated, simulator: Simulator, robot: Robot
) -> list[SignalError]:
    """The errors of every signal of a swim that a model was calibrated to.

    Args:
        swim: The fitted swim, whose end was held out.
        calibrated: The calibration, of this swim alone.
        simulator: Simulator of the calibration.
        robot: The robot.
    """
    names = [*SIGNALS, *(joint.name for joint in robot.joints)]
    units = [*UNITS, *("rad" for _ in robot.joints)]
    first = round(swim.t.size * (1 - HELD_OUT_SHARE))
    (after,) = simulated(swim, [calibrated.model], simulator)
    offset = np.nanmean((after - swim.signals)[first:], axis=0)
    size = np.sqrt(np.nanmean(swim.signals[first:] ** 2, axis=0))
    return [
        SignalError(
            name=name,
            unit=units[k],
            held_out=(float(calibrated.rmse[0, k]), float(calibrated.rmse[1, k])),
            fitted=(float(calibrated.train[0, k]), float(calibrated.train[1, k])),
            size=float(size[k]),
            offset=float(offset[k]),
        )
        for k, name in enumerate(names)
    ]


def calibration_section(
    swim: Swim, before: Model, calibrated: Calibrated, simulator: Simulator, robot: Robot
) -> Section:
    """The measured swim, its simulations before and after, the errors and comments on them.

    Args:
        swim: The fitted swim, whose end was held out.
        before: The model before the calibration.
        calibrated: The calibration.
        simulator: Simulator of the calibration.
        robot: The robot.
    """
    lead = (
        "A swim of thirty seconds in the reduced-order twin; the fit does not use its last third. "
        "The next section diagnoses errors that no parameter of the body corrects."
    )
    caption = f"{swim.name}: measured (simulated with other physics), before and after."
    errors = signal_errors(swim, calibrated, simulator, robot)
    return Section(
        "Calibration",
        lead,
        [
            comparison_block(swim, before, calibrated.model, simulator, robot, caption),
            _table(errors),
            *(Note("info", error.comment) for error in errors if error.comment),
        ],
    )


def _table(errors: Sequence[SignalError]) -> Table:
    rows = [
        (
            f"{error.name}\n{error.unit}",
            f"{error.size:.3f}",
            *(f"{x:.3f}" for x in error.held_out),
            change_text(*error.held_out),
            change_text(*error.fitted),
        )
        for error in errors
    ]
    header = ("signal", "size", "error before", "after", "change", "change\nfitted part")
    return Table(header, rows, _TABLE)
