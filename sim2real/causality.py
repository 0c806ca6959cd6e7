"""Whether a joint moves before its command does, as it seems to where two columns are swapped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_LEAD_S, LONGEST_LAG_S = 0.5, 1.0
"""Shifts of the position that are compared: earlier than the command, and later.

Later ones go further, so that a periodic command that a joint follows late, which looks the same as
one that it follows early, counts as followed late.
"""
FINEST_SHIFT_S = 0.01
FEWEST_SAMPLES, MOST_SAMPLES = 50, 4000
CLEARLY = 3.0
"""Times as much that must be left unexplained by every later shift as by the best earlier one.

Of the joints of shipped, real and generated recordings it is at most 2.0; of the same joints with
command and position swapped it is above 3 for 99 in 100 (``benchmarks/causality.py``).
"""
LARGEST_UNEXPLAINED, LEAST_GAIN = 0.5, 0.01


class Match(NamedTuple):
    """How well a shifted position matches the command.

    Attributes:
        shift_s: How much later the position comes, negative where it comes earlier.
        unexplained: One minus the squared correlation of command and shifted position.
    """

    shift_s: float
    unexplained: float


def matches(t: Array, command: Array, position: Array) -> tuple[Match, Match] | None:
    """The best match of a position that leads its command, and of one that follows it.

    Args:
        t: Times in s, shape (T,), increasing.
        command: Set-points in rad, shape (T,), all finite.
        position: Measured angles in rad, shape (T,), NaN where a sample is missing.

    Returns:
        None if the recording is too short for shifts, or the command or the position is constant.
    """
    seen = np.isfinite(position)
    inside = np.flatnonzero((t >= t[0] + LONGEST_LEAD_S) & (t <= t[-1] - LONGEST_LAG_S))
    inside = inside[:: -(-inside.size // MOST_SAMPLES) or 1]
    if inside.size < FEWEST_SAMPLES or seen.sum() < FEWEST_SAMPLES:
        return None
    step = max(FINEST_SHIFT_S, float(np.median(np.diff(t))))
    shifts = step * np.arange(-int(LONGEST_LEAD_S / step), int(LONGEST_LAG_S / step) + 1)
    shifted = np.interp(t[inside] + shifts[:, None], t[seen], position[seen])
    shifted -= shifted.mean(axis=1, keepdims=True)
    sent = command[inside] - command[inside].mean()
    size = np.sqrt(np.sum(shifted**2, axis=1) * np.sum(sent**2))
    if not size.all() or (shifts < 0).sum() == 0:
        return None
    correlation = np.maximum(shifted @ sent / size, 0.0)
    unexplained = 1 - np.minimum(correlation, 1.0) ** 2
    leads = shifts < -0.5 * step
    before, after = (
        int(np.argmin(np.where(side, unexplained, np.inf))) for side in (leads, ~leads)
    )
    return (
        Match(float(shifts[before]), float(unexplained[before])),
        Match(float(shifts[after]), float(unexplained[after])),
    )


def lead_s(t: Array, command: Array, position: Array) -> float | None:
    """By how much the position leads its command in s, None unless it clearly does.

    Arguments are as for ``matches``. A servo can't know a set-point before it is sent, so no delay,
    filter or friction makes a position match its command best at an earlier time.
    """
    found = matches(t, command, position)
    if found is None:
        return None
    before, after = found
    clear = after.unexplained > max(CLEARLY * before.unexplained, LEAST_GAIN)
    return -before.shift_s if clear and before.unexplained < LARGEST_UNEXPLAINED else None
