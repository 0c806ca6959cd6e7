"""What leaving a technique out costs: agents paired by their seeds, with what that can tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

OUTCOME = "return"
"""What is compared: the rewards of a turn discounted as in training, which is what agents learn to
earn. The plain reward has no price of time and pays who dawdles most."""
SHARE = 1 / 3
"""An interval tells arms apart where it is narrower than this share of the largest difference."""


@dataclass(frozen=True)
class Difference:
    """Return of all techniques less an arm's, over S pairs of agents of one seed.

    Attributes:
        mean: Above zero where the arm loses.
        low, high: Ends of the 90 % interval (Student's, S - 1 degrees of freedom); infinite for one
            pair.
        sd: Standard deviation over the pairs; NaN for one.
        pairs: Their number S.
    """

    mean: float
    low: float
    high: float
    sd: float
    pairs: int

    @property
    def told(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.low > 0 or self.high < 0


def paired(first: NDArray[np.float64], second: NDArray[np.float64]) -> Difference:
    """The difference of two arms' agents, each its mean over the same trials, shape (S,)."""
    d = first - second
    S, mean = len(d), float(d.mean())
    if S < 2:
        return Difference(mean, -np.inf, np.inf, float("nan"), S)
    sd = float(d.std(ddof=1))
    half = float(student.ppf(0.95, S - 1)) * sd / S**0.5
    return Difference(mean, mean - half, mean + half, sd, S)


def differences(
    found: Mapping[str, Any], testbed: str = "reality", key: str = OUTCOME
) -> dict[str, Difference]:
    """Of "all" and each other arm of an ablation, by arm."""
    table: dict[str, dict[int, float]] = {}
    for agent in found["agents"]:
        mean = float(np.mean(agent[testbed][key]))
        table.setdefault(agent["arm"], {})[agent["seed"]] = mean
    whole = table.pop("all", {})
    out = {}
    for arm, own in table.items():
        seeds = [seed for seed in whole if seed in own]
        if seeds:
            both = (np.array([rows[s] for s in seeds]) for rows in (whole, own))
            out[arm] = paired(*both)
    return out


def seeds_needed(found: Mapping[str, Difference], most: int = 200) -> dict[str, int | None]:
    """Pairs after which each arm's interval is as narrow as ``SHARE`` asks, by its spread now.

    Of the largest difference among them; None where more than ``most`` are needed, or unknown.
    """
    largest = max((abs(one.mean) for one in found.values()), default=0.0)

    def needed(one: Difference) -> int | None:
        for S in range(2, most + 1):
            width = 2 * float(student.ppf(0.95, S - 1)) * one.sd / S**0.5
            if width <= SHARE * largest:
                return S
        return None

    return {arm: needed(one) for arm, one in found.items()}
