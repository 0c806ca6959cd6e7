"""Whether a joint moves before its command does, as it seems to where two columns are swapped."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CausalitySettings:
    """Settings of the test whether a position leads its command.

    Attributes:
        longest_lead_s: Largest shift of the position to earlier than the command that is compared.
        longest_lag_s: Largest shift to later. It is longer, so that a periodic response, for which
            lead and lag are not distinguishable, counts as a lag.
        finest_shift_s: Smallest step between shifts.
        fewest_samples: With fewer samples the test is skipped.
        most_samples: Largest number of samples that are compared.
        unexplained_ratio: Smallest ratio of the variance unexplained by the best later shift to
            that by the best earlier one. It is at most 2.0 for the joints of shipped, real and
            generated recordings, and above 3 for 99 % of them with command and position swapped
            (``benchmarks/causality.py``).
        largest_unexplained: Largest share of variance unexplained by the best earlier shift.
        least_unexplained: Smallest share of variance unexplained by later shifts.
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
        shift_s: Delay of the position, negative if it leads.
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
        limits: Settings of the test.

    Returns:
        None if the recording is too short for shifts, or the command or the position is constant.
    """
    measured = np.isfinite(position)
    inside = np.flatnonzero(
        (t >= t[0] + limits.longest_lead_s) & (t <= t[-1] - limits.longest_lag_s)
    )
    inside = inside[:: -(-inside.size // limits.most_samples) or 1]
    if inside.size < limits.fewest_samples or measured.sum() < limits.fewest_samples:
        return None
    step = max(limits.finest_shift_s, float(np.median(np.diff(t))))
    shifts = step * np.arange(
        -int(limits.longest_lead_s / step), int(limits.longest_lag_s / step) + 1
    )
    shifted = np.interp(t[inside] + shifts[:, None], t[measured], position[measured])
    shifted -= shifted.mean(axis=1, keepdims=True)
    sent = command[inside] - command[inside].mean()
    size = np.sqrt(np.sum(shifted**2, axis=1) * np.sum(sent**2))
    if not size.all() or (shifts < 0).sum() == 0:
        return None
    correlation = np.maximum(shifted @ sent / size, 0.0)
    unexplained = 1 - np.minimum(correlation, 1.0) ** 2
    leads = shifts < -0.5 * step
    best_lead, best_lag = (
        int(np.argmin(np.where(side, unexplained, np.inf))) for side in (leads, ~leads)
    )
    return (
        Match(float(shifts[best_lead]), float(unexplained[best_lead])),
        Match(float(shifts[best_lag]), float(unexplained[best_lag])),
    )


def lead_s(
    t: Array, command: Array, position: Array, *, limits: CausalitySettings = CAUSALITY
) -> float | None:
    """Time in s by which the position leads its command; None unless it clearly does.

    Arguments are as for ``matches``. A servo is causal: no delay, filter or friction makes a
    position match its command best at an earlier time.
    """
    best = matches(t, command, position, limits=limits)
    if best is None:
        return None
    lead, lag = best
    significant = lag.unexplained > max(
        limits.unexplained_ratio * lead.unexplained, limits.least_unexplained
    )
    return -lead.shift_s if significant and lead.unexplained < limits.largest_unexplained else None
