"""Uncertainty of a fit with correlated residuals and directions without information."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from sim2real.identification.fit import Fit
from sim2real.inference.correlated_noise import bandwidth, correlation_samples, fixed_b, long_run
from sim2real.inference.least_squares import OUTLIER_SD

Array = NDArray[np.float64]

LEVEL = 0.90
"""Probability of the intervals."""
_OPEN_SD = 1.0
"""Standard deviation in natural units above which a direction is open: not determined."""
_PART = 0.25
"""Share of an open direction from which a parameter counts as part of it."""


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the F free parameters, in their order.

    Attributes:
        sd: Standard deviations, shape (F,).
        correlation: Correlations, shape (F, F).
        half_width: Half-widths of 90 % intervals, without regard to open directions, shape (F,).
        open_directions: Indices of the parameters of each direction that is not determined.
        inflation: Largest ratio of the variance to that for independent residuals.
    """

    sd: Array
    correlation: Array
    half_width: Array
    open_directions: tuple[tuple[int, ...], ...]
    inflation: float


def uncertainty(fit: Fit, units: Array) -> Uncertainty:
    """Sandwich covariance of a robust fit whose residuals are correlated in time.

    The covariance is inv(H) S inv(H): H the curvature of the loss, S the long-run covariance of its
    gradient (Bartlett weights: Newey and West, Econometrica 55 (1987) 703-708). It is never taken
    smaller than the covariance for independent residuals. Intervals use Student's t with the
    effective number of samples. The prior counts as an additional measurement.

    Args:
        fit: The fit.
        units: Natural units of the free parameters, shape (F,).
    """
    size = OUTLIER_SD * fit.scale_rad
    curvature = np.zeros((units.size, units.size))
    plain = np.zeros_like(curvature)
    spread = np.zeros_like(curvature)
    squares, effective, spans = 0.0, 0.0, []
    for error, slopes in zip(fit.residuals, fit.jacobians, strict=True):
        slope = slopes * units
        z2 = (error / size) ** 2
        score = (error / np.sqrt(1 + z2))[:, None] * slope
        curvature += (slope / (1 + z2[:, None]) ** 1.5).T @ slope
        plain += slope.T @ slope
        time = correlation_samples(error)
        span = bandwidth(error.size, time)
        spread += long_run(score, span)
        spans.append(span)
        squares += float(np.sum(error**2 / (1 + z2)))
        effective += error.size / time
    prior_precision = np.zeros_like(curvature)
    if fit.prior is not None:
        prior_precision = fit.tempering * fit.prior * np.outer(units, units)
        curvature += prior_precision
        spread += fit.tempering * prior_precision
    samples = sum(error.size for error in fit.residuals)
    level, directions = np.linalg.eigh(curvature)
    least = 1e-12 * max(level[-1], 1e-300)
    level = np.maximum(level, least)
    independent = (squares / samples) * plain + fit.tempering * prior_precision
    along = np.maximum(
        np.einsum("ik,ij,jk->k", directions, spread, directions),
        np.einsum("ik,ij,jk->k", directions, independent, directions),
    )
    # curvature without information is round-off of either sign
    along_sd = np.where(level > least, np.sqrt(np.maximum(along, 0.0)) / level, np.inf)
    determined = along_sd < _OPEN_SD
    inverse = directions[:, determined] / level[determined] @ directions[:, determined].T
    at_least = inverse @ independent @ inverse
    covariance = _raised_to(inverse @ spread @ inverse, at_least)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    freedom = max(effective - units.size, 1.0)
    quantile = float(stdtrit(freedom, 0.5 + LEVEL / 2)) * fixed_b(float(np.mean(spans)), samples)
    correlation = covariance / np.where(np.outer(sd, sd) > 0, np.outer(sd, sd), 1.0)
    return Uncertainty(
        sd=sd * units,
        correlation=correlation,
        half_width=quantile * sd * units,
        open_directions=tuple(
            tuple(int(i) for i in np.flatnonzero(np.abs(directions[:, k]) > _PART))
            for k in np.flatnonzero(~determined)
        ),
        inflation=float(np.max(_ratio(sd**2, np.diag(at_least)))),
    )


def _ratio(variance: Array, least: Array) -> Array:
    return np.divide(variance, least, out=np.ones_like(variance), where=least > 0)


def _raised_to(covariance: Array, least: Array) -> Array:
    """Scale a covariance up where its variances fall below those of independent residuals."""
    factor = np.sqrt(np.maximum(_ratio(np.diag(least), np.diag(covariance)), 1.0))
    return np.asarray(covariance * np.outer(factor, factor))
