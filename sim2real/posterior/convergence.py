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
"""Smallest length of a chain, in autocorrelation times, for its samples to be used."""
BURN_IN_TIMES = 5
_ROUND = 500


@dataclass(frozen=True)
class Convergence:
    """How well a chain has mixed.

    Attributes:
        times: Integrated autocorrelation time of each parameter in steps, shape (F,).
        steps: Number of completed steps.
        accepted: Share of the moves that were accepted, all walkers together.
    """

    times: Array
    steps: int
    accepted: float

    @property
    def spans(self) -> float:
        """Length of the chain in units of its longest autocorrelation time."""
        return float(self.steps / self.times.max())

    @property
    def reached(self) -> bool:
        """Whether the chain is long enough."""
        return self.spans >= LEAST_TIMES

    @property
    def burn_in(self) -> int:
        """Number of initial steps to discard."""
        return min(math.ceil(BURN_IN_TIMES * float(self.times.max())), self.steps // 2)

    @property
    def thin(self) -> int:
        """Number of steps between samples that are kept."""
        return max(1, int(self.times.min() / 2))


def convergence(chain: Chain) -> Convergence:
    """Measure how well a chain has mixed."""
    times = autocorrelation_times(chain.coordinates)
    tries = max(chain.steps * chain.accepted.size, 1)
    return Convergence(times, chain.steps, float(chain.accepted.sum() / tries))


def require(convergence: Convergence, what: str, names: tuple[str, ...]) -> None:
    """Check that a chain is long enough.

    Raises:
        InputError: If it spans less than 50 autocorrelation times, with the number of steps needed.
    """
    if convergence.reached:
        return
    slowest = names[int(convergence.times.argmax())]
    needed = math.ceil(1.2 * LEAST_TIMES * convergence.times.max() / _ROUND) * _ROUND
    needed = max(needed, convergence.steps + _ROUND)
    raise InputError(
        what,
        slowest,
        f"{convergence.steps} steps, {convergence.spans:.0f} of its autocorrelation times",
        f"at least {LEAST_TIMES}; run again with --steps {needed}: the chain continues",
    )


def sample(chain: Chain, convergence: Convergence) -> Array:
    """Thinned samples after the burn-in, standardised coordinates of shape (N, F)."""
    kept = chain.coordinates[convergence.burn_in :: convergence.thin]
    return np.asarray(kept.reshape(-1, kept.shape[2]))
