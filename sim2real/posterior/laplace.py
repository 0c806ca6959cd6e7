"""Laplace approximation of a posterior, which defines the start and the scaling of a chain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.servo_problem import Servos, minimise
from sim2real.inference.parameters import column
from sim2real.posterior.likelihood import ServoData


@dataclass(frozen=True)
class Laplace:
    """A normal distribution in unbounded coordinates, and the noise model fitted with it.

    Attributes:
        centre: Coordinates of the optimum, shape (F,).
        factor: Lower triangle with ``factor @ factor.T`` the covariance, shape (F, F).
        autoregression: Coefficients of the noise, shape (p,).
        noise_sd: Standard deviation of the innovations in rad.
    """

    centre: Array
    factor: Array
    autoregression: Array
    noise_sd: float

    def coordinates(self, w: Array) -> Array:
        """Unbounded coordinates of standardised ones (..., F)."""
        return np.asarray(self.centre + w @ self.factor.T)


def laplace(data: ServoData, *, iterations: int = 40, widest_sd: float = 2.0) -> Laplace:
    """Fit the joint and compute the curvature of its log-posterior at the optimum.

    The curvature is that of the whitened sum of squares (Gauss-Newton) plus the priors'. Source:
    Tierney and Kadane, Journal of the American Statistical Association 81 (1986) 82-86. Coordinates
    that the recordings do not constrain have the standard deviation ``widest_sd``.
    """
    priors = data.priors
    start = priors.values(priors.coordinates(data.row[data.columns]))
    low, high = (column(priors.each, end)[None] for end in ("low", "high"))
    unit = np.maximum(np.abs(start), 0.01 * np.minimum(high[0] - low[0], 1.0))[None]
    theta = data.theta(start[None])
    columns = np.array([data.columns], dtype=np.int32)
    servos = Servos(np.zeros(1, dtype=np.int32), theta, columns, unit, low, high)
    fits = minimise(data.batch, servos, iterations=iterations)
    gram = fits.gram[0].sum(axis=0)
    variance = gram[0, 0] / max(float(fits.count[0]) - fits.autoregression.shape[1], 1.0)
    centre = priors.coordinates(fits.servos.theta[0, data.columns])
    slope = priors.slope(centre) / unit[0]
    information = gram[1:, 1:] / variance * np.outer(slope, slope)
    information += np.diag(priors.curvature(centre) + 1 / widest_sd**2)
    level, directions = np.linalg.eigh(information)
    covariance = (directions / np.maximum(level, 1 / widest_sd**2)) @ directions.T
    return Laplace(
        centre=centre,
        factor=np.linalg.cholesky(covariance),
        autoregression=fits.autoregression[0].copy(),
        noise_sd=float(np.sqrt(variance)),
    )


def sharpened(
    start: Laplace,
    log_posterior: Callable[[Array], Array],
    *,
    rounds: int = 8,
    longest_step_sd: float = 4.0,
    settled_sd: float = 0.1,
    limits: tuple[float, float] = (0.02, 50.0),
) -> Laplace:
    """Refine the optimum with the log-posterior that is sampled, and the curvature there.

    The rollouts of the fit have longer sub-steps than those of the sampler, so that the optimum of
    a sharp posterior may be several standard deviations away. Newton's method with central
    differences over one standard deviation, which smooths kinks due to friction and backlash.

    Args:
        start: Result of the fit.
        log_posterior: Log-posterior of unbounded coordinates (B, F), shape (B,).
        rounds: Largest number of steps.
        longest_step_sd: Longest step, in standard deviations.
        settled_sd: Length of a step below which the search ends, likewise.
        limits: Smallest and largest curvature relative to the previous estimate, beyond which it is
            attributed to noise of the differences.
    """
    best, current = float(log_posterior(start.centre[None])[0]), start
    for _ in range(rounds):
        differences = _differences(current, log_posterior)
        if differences is None:
            break
        slope, curvature = differences
        level, directions = np.linalg.eigh(curvature)
        level = np.clip(level, *limits)
        step = directions @ ((directions.T @ slope) / level)
        step *= min(1.0, longest_step_sd / max(float(np.linalg.norm(step)), 1e-12))
        centre = current.coordinates(step)
        value = float(log_posterior(centre[None])[0])
        covariance = current.factor @ (directions / level) @ directions.T @ current.factor.T
        current = replace(current, factor=np.linalg.cholesky(0.5 * (covariance + covariance.T)))
        if not value > best:
            break
        best, current = value, replace(current, centre=centre)
        if np.linalg.norm(step) < settled_sd:
            break
    return current


def _differences(
    at: Laplace, log_posterior: Callable[[Array], Array], *, step_sd: float = 1.0
) -> tuple[Array, Array] | None:
    """Slope (F,) of the log-posterior and minus its curvature (F, F), standardised.

    None where the log-posterior is not finite at all points of the differences.
    """
    F, h = at.centre.size, step_sd
    unit, pairs = h * np.eye(F), list(combinations(range(F), 2))
    corners = [a * unit[i] + b * unit[j] for i, j in pairs for a in (1, -1) for b in (1, -1)]
    points = np.array([np.zeros(F), *unit, *-unit, *corners])
    value = log_posterior(at.coordinates(points))
    if not np.isfinite(value).all():
        return None
    ahead, back, corner = value[1 : F + 1], value[F + 1 : 2 * F + 1], value[2 * F + 1 :]
    curvature = np.diag(2 * value[0] - ahead - back) / h**2
    for k, (i, j) in enumerate(pairs):
        cross = corner[4 * k] - corner[4 * k + 1] - corner[4 * k + 2] + corner[4 * k + 3]
        curvature[i, j] = curvature[j, i] = -cross / (4 * h**2)
    return (ahead - back) / (2 * h), curvature
