"""Fit parameters to swims in a simulator with a known relative error.

In cells of one centimetre a swimmer is up to 12 % too fast or too slow, depending on the gait
(``reports/resolution``). A fit that treats this error as measurement noise reports intervals that
are too narrow. Here the error of a signal at a time is normal; its variance is that of the
recording's noise plus the square of ``SHARE`` of the signal's local amplitude. The error is
correlated: a signal counts as one sample per autocorrelation time of its residual. Intervals use
the Laplace approximation (MacKay, Neural Comput. 4 (1992) 415).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from sim.calibration.swim_problem import BLOCK, HELD_OUT_SHARE, SwimProblem, seen
from sim.inference.swims import Simulator, Swim
from sim2real.arrays import Array
from sim2real.inference.correlated_noise import autocorrelation_times
from sim2real.inference.parameters import Gaussian, Parameter, column
from sim2real.model import Model

SHARE = 0.2
"""Standard deviation of the calibrated fluid's error in cells of 1 cm, relative to the signal."""
_ROUNDS = 2
_EVALUATIONS = 14
_STEP = 0.02
"""Step of the derivatives, in the priors' standard deviations."""
_INSIDE = 0.3
"""Least distance of the start from the bounds, in typical sizes: a search would stay at a bound."""
_LONGEST = 200.0
"""Longest autocorrelation time in samples that twenty seconds of a swim can show."""
_SLOW_NOISE = 0.25
"""Upper bound of the noise of a mean over two seconds, relative to that of the velocity."""


@dataclass(frozen=True)
class Fitted:
    """A maximum a posteriori fit.

    Attributes:
        model: The model with the fitted values.
        free: The F fitted parameters.
        best: Their values, shape (F,).
        covariance: Covariance of the posterior, shape (F, F).
    """

    model: Model
    free: tuple[Parameter, ...]
    best: Array
    covariance: Array

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
    held_out: float = HELD_OUT_SHARE,
) -> Fitted:
    """Fit parameters to the first part of each swim.

    Args:
        swims: Recordings.
        model: Start of the search.
        free: Parameters to fit; their priors are independent.
        simulator: Simulator to fit, usually an ``Emulator``.
        held_out: Share of each swim, at its end, that the fit does not use.
    """
    free = tuple(free)
    prior = Gaussian.of(free)
    problem = SwimProblem(swims, model, free, simulator, prior, seen, held_out)
    scale = np.sqrt(np.diag(prior.covariance))
    low, high = (column(free, end) for end in ("low", "high"))
    inside = _INSIDE * np.minimum(column(free, "typical"), high - low)
    best = np.clip(prior.mean, low + inside, high - inside)
    for _ in range(_ROUNDS):
        weights = [
            _weight(swim, error[0], end)
            for swim, error, end in zip(swims, problem.errors(best[None]), problem.cut, strict=True)
        ]
        minimum = problem.minimise(best, weights, unit=scale, step=_STEP, evaluations=_EVALUATIONS)
        best = minimum.values
    return Fitted(
        model=problem.with_values(best),
        free=free,
        best=best,
        covariance=np.asarray(np.linalg.inv(minimum.curvature), dtype=np.float64),
    )


def rmse(swim: Swim, track: Array, *, held_out: float = HELD_OUT_SHARE) -> Array:
    """Root mean square errors of signals (E, T, 3 + J), fitted and held out: (2, E, 3 + J)."""
    error = track - swim.signals
    cut = round(swim.t.size * (1 - held_out))
    parts = (error[:, :cut], error[:, cut:])
    return np.stack([np.sqrt(np.nanmean(part**2, axis=1)) for part in parts])


def _weight(swim: Swim, error: Array, end: int) -> Array:
    """Reciprocal standard deviation of each sample's error, shape (T, K)."""
    noise = np.broadcast_to(swim.noise, swim.signals.shape[1:])
    noise = np.concatenate([noise, _SLOW_NOISE * noise[:3]])
    size = np.sqrt(uniform_filter1d(swim.signals**2, BLOCK + 1, axis=0, mode="nearest"))
    size = np.concatenate([size, size[:, :3]], axis=1)
    least = 1e-3 * np.sqrt((size**2).mean(axis=0)) + 1e-9
    sd = np.sqrt(noise**2 + (SHARE * size) ** 2 + least**2)
    residual = (error / sd)[:end]
    residual = residual - residual.mean(axis=0)
    times = [float(autocorrelation_times(column)[0]) for column in residual.T]
    return np.asarray(1 / (sd * np.sqrt(np.minimum(times, _LONGEST))))
