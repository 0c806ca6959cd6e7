"""What a fit does not see, and the error there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Data = TypeVar("Data")

LONE_SHARE = 0.25
"""Share of a lone recording, at its end, that is held out unless one says otherwise."""


def until(t: Array, share: float = LONE_SHARE) -> float:
    """Time at which the held-out end of a recording with times ``t`` (T,) begins."""
    return float(t[0] + (1 - share) * (t[-1] - t[0]))


def each_in_turn(data: Sequence[Data]) -> list[tuple[list[Data], Data]]:
    """Pairs of what is fitted and what is held out: each once."""
    return [([other for other in data if other is not one], one) for one in data]


def rms(errors: Sequence[Array]) -> float:
    """Root mean square over all arrays; 0 where there is no sample, infinite where it overflows."""
    count = sum(error.size for error in errors)
    with np.errstate(over="ignore"):  # of a simulation that has run away
        return float(np.sqrt(sum(np.sum(error**2) for error in errors) / max(count, 1)))
