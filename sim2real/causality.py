"""Whether a joint moves before its command does, as it seems to where two columns are swapped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CausalitySettings:
    """How clearly a position must lead its command to be refused.

    Attributes:
        longest_lead_s: Largest shift of the position to earlier than the command that is compared.
        longest_lag_s: Largest shift to later. It is longer, so that a periodic command that a joint
            follows late, which looks the same as one that it follows early, counts as followed
            late.
        finest_shift_s: Smallest step between shifts.
        fewest_samples: With fewer samples nothing is compared.
        most_samples: Samples that are compared at most.
        unexplained_ratio: Times as much that must be left unexplained by every later shift as by
            the best earlier one. Of the joints of shipped, real and generated recordings it is at
            most 2.0; of the same joints with command and position swapped it is above 3 for 99 in
            100 (``benchmarks/causality.py``).
        largest_unexplained: Share that the best earlier shift may leave unexplained.
        least_unexplained: Share that later shifts must leave unexplained.
    """

    longest_lead_s: float = 0.5
    longest_lag_s: float = 1.0
    finest_shift_s: float = 0.01
    fewest_samples: int = 50
    most_samples: int = 4000
    unexplained_ratio: float = 3.0
    largest_unexplained: float = 0.5
    least_unexplained: float = 0.01


CAUSALITY = CausalitySettings()
"""The defaults."""


class Match(NamedTuple):
    """How well a shifted position matches the command.

    Attributes:
        shift_s: How much later the position comes, negative where it comes earlier.
        unexplained: One minus the squared correlation of command and shifted position.
    """

    shift_s: float
    unexplained: float


def matches(
    t: Array, command: Array, position: Array, *, limits: CausalitySettings = CAUSALITY
) -> tuple[Match, Match] | None:
    """The best match of a position that leads its command, and of one that follows it.

    Args:
        t: Times in s, shape (T,), increasing.
        command: Set-points in rad, shape (T,), all finite.
        position: Measured angles in rad, shape (T,), NaN where a sample is missing.
        limits: Shifts that are compared, and from when on one counts.

    Returns:
        None if the recording is too short for shifts, or the command or the position is constant.
    """
    seen = np.isfinite(position)
    inside = np.flatnonzero(
        (t >= t[0] + limits.longest_lead_s) & (t <= t[-1] - limits.longest_lag_s)
    )
    inside = inside[:: -(-inside.size // limits.most_samples) or 1]
    if inside.size < limits.fewest_samples or seen.sum() < limits.fewest_samples:
        return None
    step = max(limits.finest_shift_s, float(np.median(np.diff(t))))
    shifts = step * np.arange(
        -int(limits.longest_lead_s / step), int(limits.longest_lag_s / step) + 1
    )
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


def lead_s(
    t: Array, command: Array, position: Array, *, limits: CausalitySettings = CAUSALITY
) -> float | None:
    """By how much the position leads its command in s, None unless it clearly does.

    Arguments are as for ``matches``. A servo can't know a set-point before it is sent, so no delay,
    filter or friction makes a position match its command best at an earlier time.
    """
    found = matches(t, command, position, limits=limits)
    if found is None:
        return None
    before, after = found
    clear = after.unexplained > max(
        limits.unexplained_ratio * before.unexplained, limits.least_unexplained
    )
    return -before.shift_s if clear and before.unexplained < limits.largest_unexplained else None
