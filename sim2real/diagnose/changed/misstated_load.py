"""Whether the load that a recording states is the one that it had."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.changed.regression import Explained, loss, restated
from sim2real.effects import CATALOGUE
from sim2real.servo.parameters import COLUMNS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Misstated:
    """What speaks for the load of the references, where another is stated.

    Attributes:
        effects: The effects that stand for the difference.
        gain: Gain in log-likelihood with the references' load.
        row: Parameters of the servo under the stated load, with the difference, shape (P,).
    """

    effects: tuple[str, ...]
    gain: float
    row: Array


def misstated(of: Explained) -> Misstated | None:
    """Whether a servo that explains the references explains the case better with their load.

    Nothing is free in this: both loads are stated, and one servo is fitted to all recordings with
    the one or the other. So it tells more than the search for a load of any size.

    Returns:
        What speaks for the references' load; None where the loads do not differ.
    """
    known, stated = of.traces[0].load, of.traces[of.references].load
    alike = all(t.load == known for t in of.traces[: of.references])
    if not alike or any(of.traces[r].load != stated for r in of.case):
        return None
    differs = {
        f"{effect.name}.{effect.parameters[0].name}": difference
        for effect in CATALOGUE
        if effect.load
        and (difference := getattr(known, effect.load) - getattr(stated, effect.load)) != 0
    }
    if not differs:
        return None
    row = of.row.copy()
    for column, value in differs.items():
        row[COLUMNS.index(column)] += value
    gain = 0.5 * (loss(of) - loss(restated(of, of.traces[0]))) / of.variance
    return Misstated(tuple(column.partition(".")[0] for column in differs), gain, row)
