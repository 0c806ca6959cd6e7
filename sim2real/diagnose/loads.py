"""A load that is stated to differ from that of the references, and does not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.problem import Fits, Servos, minimise
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

GRAVITY, INERTIA = "gravity_load.torque_Nm", "unmodelled_inertia.inertia_kgm2"


@dataclass(frozen=True)
class Misstated:
    """What speaks for the load of the references, where another is stated.

    Attributes:
        differs: What the references' load has more, by column: torque in N m, inertia in kg m2.
        gain: Gain in log-likelihood with the references' load.
        theta: Parameters of the servo under the stated load, with the difference, shape (P,).
    """

    differs: Mapping[str, float]
    gain: float
    theta: Array

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that stand for the difference."""
        return tuple(column.partition(".")[0] for column in self.differs)


def misstated(
    references: Sequence[Trace],
    case: Sequence[Trace],
    servos: Sequence[Servos],
    device: str = "cpu",
) -> Misstated | None:
    """Whether a servo that explains the references explains the case better with their load.

    Nothing is free in this: both loads are stated, and one servo is fitted to all recordings with
    the one or the other. So it tells more than the search for a load of any size.

    Args:
        references: The joint's references.
        case: Its recordings in question.
        servos: Where the servo starts from.
        device: Warp device.

    Returns:
        What speaks for the references' load; None where the loads do not differ.
    """
    known, stated = references[0].load, case[0].load
    if any(t.load != known for t in references) or any(t.load != stated for t in case):
        return None
    more = {
        GRAVITY: known.gravity_Nm - stated.gravity_Nm,
        INERTIA: known.inertia_kgm2 - stated.inertia_kgm2,
    }
    differs = {column: value for column, value in more.items() if value != 0}
    if not differs:
        return None
    as_before = _fitted([*references, *(replace(t, load=known) for t in case)], servos, device)
    as_stated = _fitted([*references, *case], servos, device)
    theta = as_before.servos.theta[0].copy()
    for column, value in differs.items():
        theta[COLUMNS.index(column)] += value
    gain = float(as_before.loglikelihood[0] - as_stated.loglikelihood[0])
    return Misstated(differs, gain, theta)


def _fitted(traces: Sequence[Trace], servos: Sequence[Servos], device: str) -> Fits:
    batch = Batch([list(traces)], device)
    fits = [minimise(batch, one, iterations=15) for one in servos]
    return max(fits, key=lambda fit: float(fit.loglikelihood[0]))
