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
from scipy.optimize import least_squares
from scipy.stats import norm

from sim.inference.calibrate import BLOCK, HELD_OUT_SHARE, Free, seen
from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim2real.inference.noise import autocorrelation_times
from sim2real.model import Model

Array = NDArray[np.float64]

SHARE = 0.2
"""Error of the fluid in cells of 1 cm as a share of a signal's size, once calibrated."""
_ROUNDS = 2
_EVALUATIONS = 8
_STEP = 0.02
"""Step of the derivatives, in the priors' standard deviations."""
_INSIDE = 0.3
"""How far from its bounds a search begins, in sizes: at a bound it would not leave it."""
_LONGEST = 200.0
"""Longest autocorrelation time in samples that a third of a minute can show."""
_SLOW_NOISE = 0.25
"""Noise of a mean over two seconds against that of the velocity itself, or less."""


@dataclass(frozen=True)
class Prior:
    """A normal prior of some parameters.

    Attributes:
        mean: Shape (F,).
        covariance: Shape (F, F).
    """

    mean: Array
    covariance: Array

    @classmethod
    def of(cls, free: Sequence[Free]) -> Prior:
        """Independent, as the parameters say."""
        sd = np.array([p.prior_sd for p in free])
        return cls(np.array([p.start for p in free]), np.diag(sd**2))


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
    free: tuple[Free, ...]
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

    def marginal(self, names: Sequence[str]) -> Prior:
        """The posterior of some parameters, as a prior of the next fit."""
        listed = [p.name for p in self.free]
        rows = [listed.index(name) for name in names]
        return Prior(self.best[rows], self.covariance[np.ix_(rows, rows)])


def fit(
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Free],
    simulator: Simulator,
    *,
    prior: Prior | None = None,
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
    prior = prior or Prior.of(free)
    names = [p.name for p in free]
    root = np.linalg.inv(np.linalg.cholesky(prior.covariance))
    scale = np.sqrt(np.diag(prior.covariance))
    low, high = (np.array([getattr(p, end) for p in free]) for end in ("low", "high"))
    cut = [round(swim.t.size * (1 - held_out)) for swim in swims]
    shown = [seen(swim.signals) for swim in swims]

    def errors(points: Array) -> list[Array]:
        models = [with_values(model, _named(names, x)) for x in points]
        return [
            np.nan_to_num(seen(simulated(swim, models, simulator)) - was, nan=1e3)
            for swim, was in zip(swims, shown, strict=True)
        ]

    def row(points: Array, by: Sequence[Array]) -> Array:
        parts = [
            (error * w)[:, :end].reshape(len(points), -1)
            for error, w, end in zip(errors(points), by, cut, strict=True)
        ]
        return np.concatenate([*parts, (points - prior.mean) @ root.T], axis=1)

    inside = _INSIDE * np.minimum([p.size for p in free], high - low)
    x = np.clip(prior.mean, low + inside, high - inside)
    by: Sequence[Array] = ()
    for _ in range(_ROUNDS if weights is None else 1):
        by = weights or [
            _weight(swim, error[0], share, end)
            for swim, error, end in zip(swims, errors(x[None]), cut, strict=True)
        ]

        def slope(point: Array, by: Sequence[Array] = by) -> Array:
            own = np.eye(len(free), dtype=bool)
            ahead = np.minimum(point + _STEP * scale, high)
            back = np.maximum(point - _STEP * scale, low)
            points = np.concatenate([np.where(own, ahead, point), np.where(own, back, point)])
            moved = row(points, by)
            change = moved[: len(free)] - moved[len(free) :]
            return np.asarray((change / (ahead - back)[:, None]).T)

        def miss(point: Array, by: Sequence[Array] = by) -> Array:
            return np.asarray(row(point[None], by)[0])

        found = least_squares(
            miss,
            np.clip(x, low + 1e-9 * scale, high - 1e-9 * scale),
            slope,
            bounds=(low, high),
            x_scale=scale,
            max_nfev=_EVALUATIONS,
        )
        x = found.x
    slopes = np.asarray(found.jac)
    curve = slopes.T @ slopes
    size = float(np.linalg.slogdet(curve)[1] + np.linalg.slogdet(prior.covariance)[1])
    return Fitted(
        model=with_values(model, _named(names, x)),
        free=free,
        best=x,
        covariance=np.linalg.inv(curve),
        evidence=-float(found.cost) - size / 2,
        weights=tuple(by),
    )


def rmse(swim: Swim, track: Array, *, held_out: float = HELD_OUT_SHARE) -> Array:
    """Root mean square errors of signals (E, T, 3 + J), fitted and held out: (2, E, 3 + J)."""
    error = track - swim.signals
    cut = round(swim.t.size * (1 - held_out))
    parts = (error[:, :cut], error[:, cut:])
    return np.stack([np.sqrt(np.nanmean(part**2, axis=1)) for part in parts])


def _named(names: Sequence[str], x: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, x, strict=True)}


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


__all__ = ["SHARE", "Fitted", "Prior", "fit", "rmse"]
