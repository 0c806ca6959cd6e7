"""Loss without each technique: differences of agents paired by seed, with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from sim2real.arrays import Array

OUTCOME = "return"
"""Compared quantity: the rewards of a turn discounted as in training, which agents maximise. The
undiscounted sum does not penalise time and favours slow turns."""
STILL = 0.0
"""Return of a robot that does not move. An agent that moves erratically for a whole turn can lose
fifty times the return of an arrival and dominate the mean; with returns floored at this value, as
if such a robot were switched off, fewer pairs are needed."""
SHARE = 1 / 3
"""Required width of an interval, as a share of the largest difference."""


@dataclass(frozen=True)
class Difference:
    """Return with all techniques minus that of an arm, over S pairs of agents with the same seed.

    Attributes:
        mean: Positive if the arm is worse.
        low, high: Ends of the 90 % interval (Student's, S - 1 degrees of freedom); infinite for one
            pair.
        sd: Standard deviation over the pairs; NaN for one.
        pairs: Number of pairs S.
    """

    mean: float
    low: float
    high: float
    sd: float
    pairs: int

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def paired(first: Array, second: Array) -> Difference:
    """Difference of two arms, given the mean of each agent over the same trials, shape (S,)."""
    d = first - second
    S, mean = len(d), float(d.mean())
    if S < 2:
        return Difference(mean, -np.inf, np.inf, float("nan"), S)
    sd = float(d.std(ddof=1))
    margin = float(student.ppf(0.95, S - 1)) * sd / S**0.5
    return Difference(mean, mean - margin, mean + margin, sd, S)


def differences(results: Mapping[str, Any], *, floor: float | None = None) -> dict[str, Difference]:
    """Differences in reality of "all" and each other arm of an ablation, by arm.

    Args:
        results: Result of ``ablate``.
        floor: Lower bound applied to each turn; none by default.
    """
    table: dict[str, dict[int, float]] = {}
    for agent in results["agents"]:
        mean = float(
            np.maximum(agent["reality"][OUTCOME], -np.inf if floor is None else floor).mean()
        )
        table.setdefault(agent["arm"], {})[agent["seed"]] = mean
    reference = table.pop("all", {})
    out = {}
    for arm, outcomes in table.items():
        seeds = [seed for seed in reference if seed in outcomes]
        if seeds:
            samples = (np.array([rows[s] for s in seeds]) for rows in (reference, outcomes))
            out[arm] = paired(*samples)
    return out


def seeds_needed(losses: Mapping[str, Difference], most: int = 200) -> dict[str, int | None]:
    """Pairs for an interval narrower than ``SHARE`` of the largest difference, by arm.

    Computed from the present spread over pairs; None if unknown or more than ``most``.
    """
    largest = max((abs(loss.mean) for loss in losses.values()), default=0.0)

    def needed(loss: Difference) -> int | None:
        for S in range(2, most + 1):
            width = 2 * float(student.ppf(0.95, S - 1)) * loss.sd / S**0.5
            if width <= SHARE * largest:
                return S
        return None

    return {arm: needed(loss) for arm, loss in losses.items()}
