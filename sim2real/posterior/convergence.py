"""Whether a chain has converged, and its samples after the burn-in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError
from sim2real.inference.correlated_noise import autocorrelation_times
from sim2real.posterior.chain import Chain

Array = NDArray[np.float64]

LEAST_TIMES = 50
"""Autocorrelation times that a chain must span before anything of it is published."""
BURN_IN_TIMES = 5
_ROUND = 500


@dataclass(frozen=True)
class Convergence:
    """How well a chain has mixed.

    Attributes:
        times: Integrated autocorrelation time of each parameter in steps, shape (F,).
        steps: Steps made.
        accepted: Share of the moves that were accepted, all walkers together.
    """

    times: Array
    steps: int
    accepted: float

    @property
    def spans(self) -> float:
        """Length of the chain in its longest autocorrelation time."""
        return float(self.steps / self.times.max())

    @property
    def reached(self) -> bool:
        """Whether the chain is long enough."""
        return self.spans >= LEAST_TIMES

    @property
    def burn_in(self) -> int:
        """Steps to forget."""
        return min(math.ceil(BURN_IN_TIMES * float(self.times.max())), self.steps // 2)

    @property
    def thin(self) -> int:
        """Steps from one that is kept to the next."""
        return max(1, int(self.times.min() / 2))


def convergence(chain: Chain) -> Convergence:
    """Measure how well a chain has mixed."""
    times = autocorrelation_times(chain.coordinates)
    tries = max(chain.steps * chain.accepted.size, 1)
    return Convergence(times, chain.steps, float(chain.accepted.sum() / tries))


def require(found: Convergence, what: str, names: tuple[str, ...]) -> None:
    """Refuse a chain that is too short.

    Raises:
        InputError: If it spans less than 50 autocorrelation times; says how many steps would do.
    """
    if found.reached:
        return
    slowest = names[int(found.times.argmax())]
    needed = math.ceil(1.2 * LEAST_TIMES * found.times.max() / _ROUND) * _ROUND
    needed = max(needed, found.steps + _ROUND)
    raise InputError(
        what,
        slowest,
        f"{found.steps} steps, {found.spans:.0f} of its autocorrelation times",
        f"at least {LEAST_TIMES}; run again with --steps {needed}: the chain goes on where it is",
    )


def sample(chain: Chain, found: Convergence) -> Array:
    """What is kept of a chain, standardised coordinates of shape (N, F), step by step."""
    kept = chain.coordinates[found.burn_in :: found.thin]
    return np.asarray(kept.reshape(-1, kept.shape[2]))
