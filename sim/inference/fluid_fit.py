"""Fit parameters to swims in a simulator that is known to be wrong by a share of what moves.

In cells of a centimetre a swimmer is up to an eighth too fast or slow, another way under each wave
(``reports/resolution``). A fit that takes what is left for noise believes every
parameter that hides it. Here the error of a signal at a moment is normal, with the recording's
noise and ``SHARE`` of the signal's size about that moment, and it lasts: a signal counts as one
sample an autocorrelation time of what is left of it. Intervals and evidence are Laplace's (MacKay,
Neural Comput. 4 (1992) 415).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from sim.inference.problem import BLOCK, HELD_OUT_SHARE, SwimProblem, seen
from sim.inference.swims import Simulator, Swim
from sim2real.inference.evidence import log_evidence
from sim2real.inference.noise import autocorrelation_times
from sim2real.inference.parameters import Gaussian, Parameter, column
from sim2real.model import Model

Array = NDArray[np.float64]

SHARE = 0.2
"""Error of the fluid in cells of 1 cm as a share of a signal's size, once calibrated."""
_ROUNDS = 2
_EVALUATIONS = 14
_STEP = 0.02
"""Step of the derivatives, in the priors' standard deviations."""
_INSIDE = 0.3
"""How far from its bounds a search begins, in sizes: at a bound it would not leave it."""
_LONGEST = 200.0
"""Longest autocorrelation time in samples that a third of a minute can show."""
_SLOW_NOISE = 0.25
"""Noise of a mean over two seconds against that of the velocity itself, or less."""


@dataclass(frozen=True)
class Fitted:
    """What a fit found.

    Attributes:
        model: The model with the best values.
        free: What was fitted.
        best: Its values, shape (F,).
        covariance: Of the posterior, shape (F, F).
        evidence: Logarithm of the probability of the fitted part, up to a constant that all fits
            with the same weights share.
        weights: One over the errors' standard deviations, one array (T, K) a swim.
    """

    model: Model
    free: tuple[Parameter, ...]
    best: Array
    covariance: Array
    evidence: float
    weights: tuple[Array, ...]

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (F,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def interval(self, level: float = 0.9) -> Array:
        """Central intervals, shape (F, 2)."""
        reach = float(norm.ppf(0.5 + level / 2)) * self.sd
        return np.stack([self.best - reach, self.best + reach], axis=1)


def fit(
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Parameter],
    simulator: Simulator,
    *,
    prior: Gaussian | None = None,
    share: float = SHARE,
    weights: Sequence[Array] | None = None,
    held_out: float = HELD_OUT_SHARE,
) -> Fitted:
    """Fit parameters to the first part of each swim.

    Args:
        swims: Recordings.
        model: Where the search begins.
        free: What is fitted.
        simulator: What is fitted to them, as a rule an ``Emulator``.
        prior: Of the parameters; independent, as they say, where None.
        share: Error of the simulator as a share of a signal's size.
        weights: Of another fit, so that their evidences can be compared; own ones where None.
        held_out: Share of each swim at its end that the fit does not see.
    """
    free = tuple(free)
    prior = prior or Gaussian.of(free)
    problem = SwimProblem(swims, model, free, simulator, prior, seen, held_out)
    scale = np.sqrt(np.diag(prior.covariance))
    low, high = (column(free, end) for end in ("low", "high"))
    inside = _INSIDE * np.minimum(column(free, "typical"), high - low)
    best = np.clip(prior.mean, low + inside, high - inside)
    by: Sequence[Array] = ()
    for _ in range(_ROUNDS if weights is None else 1):
        by = weights or [
            _weight(swim, error[0], share, end)
            for swim, error, end in zip(swims, problem.errors(best[None]), problem.cut, strict=True)
        ]
        found = problem.minimise(best, by, unit=scale, step=_STEP, evaluations=_EVALUATIONS)
        best = found.values
    return Fitted(
        model=problem.with_values(best),
        free=free,
        best=best,
        covariance=np.asarray(np.linalg.inv(found.curvature), dtype=np.float64),
        evidence=log_evidence(found.loss, found.curvature, prior.covariance),
        weights=tuple(by),
    )


def rmse(swim: Swim, track: Array, *, held_out: float = HELD_OUT_SHARE) -> Array:
    """Root mean square errors of signals (E, T, 3 + J), fitted and held out: (2, E, 3 + J)."""
    error = track - swim.signals
    cut = round(swim.t.size * (1 - held_out))
    parts = (error[:, :cut], error[:, cut:])
    return np.stack([np.sqrt(np.nanmean(part**2, axis=1)) for part in parts])


def _weight(swim: Swim, error: Array, share: float, end: int) -> Array:
    """One over the standard deviation of each sample's error, shape (T, K)."""
    noise = np.broadcast_to(swim.noise, swim.signals.shape[1:])
    noise = np.concatenate([noise, _SLOW_NOISE * noise[:3]])
    size = np.sqrt(uniform_filter1d(swim.signals**2, BLOCK + 1, axis=0, mode="nearest"))
    size = np.concatenate([size, size[:, :3]], axis=1)
    least = 1e-3 * np.sqrt((size**2).mean(axis=0)) + 1e-9
    sd = np.sqrt(noise**2 + (share * size) ** 2 + least**2)
    left = (error / sd)[:end]
    left = left - left.mean(axis=0)
    times = [float(autocorrelation_times(column)[0]) for column in left.T]
    return np.asarray(1 / (sd * np.sqrt(np.minimum(times, _LONGEST))))


__all__ = ["SHARE", "Fitted", "fit", "rmse"]
