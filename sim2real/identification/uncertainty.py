"""Uncertainty of a fit with correlated residuals, and intervals of its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import stdtrit
from scipy.stats import chi2

from sim2real.arrays import Array
from sim2real.identification.problem import Fit
from sim2real.identification.repeating_error import repeating_error
from sim2real.inference.correlated_noise import bandwidth, correlation_samples, fixed_b, long_run
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.inference.normal import LEVEL
from sim2real.inference.parameters import column
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, LINE

GAINS = BASE[:2]


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the F free parameters of a fit, as searched, in units."""

    covariance: Array  # shape (F, F); 0 for directions that are not determined
    half_width: Array  # half-widths of intervals, without regard to open directions, shape (F,)
    # indices of the parameters of each direction that is not determined
    open_directions: tuple[tuple[int, ...], ...]
    level: float  # probability of the intervals

    @property
    def sd(self) -> Array:
        """Standard deviations, shape (F,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def correlation(self) -> Array:
        """Correlations, shape (F, F)."""
        size = np.outer(self.sd, self.sd)
        return np.asarray(self.covariance / np.where(size > 0, size, 1.0))

    def by_pair(self, names: Sequence[str]) -> dict[str, float]:
        """Correlation of each pair of parameters, by their names."""
        pairs = combinations(range(len(names)), 2)
        return {f"{names[i]}, {names[j]}": float(self.correlation[i, j]) for i, j in pairs}

    @property
    def least_loss(self) -> float:
        """Loss beyond these intervals: of a region, which may be disconnected."""
        return float(chi2.ppf(self.level, 3))  # hence of three parameters

    @property
    def undetermined(self) -> set[int]:
        """Indices of the parameters in open directions."""
        return {k for direction in self.open_directions for k in direction}


def uncertainty(
    best: Fit, *, level: float = LEVEL, repeating: bool = True, part: float = 0.25
) -> Uncertainty:
    """Sandwich covariance of a robust fit whose residuals are correlated in time.

    The covariance is inv(H) S inv(H): H the curvature of the loss, S the long-run covariance of its
    gradient (Bartlett weights: Newey and West, Econometrica 55 (1987) 703-708). It is never taken
    smaller than the covariance for independent residuals. Errors that repeat with the angle add to
    S (``repeating_error``) if ``repeating``. Intervals use Student's t with the effective number of
    samples and, of repeating errors, of coefficients, combined for each parameter (Satterthwaite,
    Biometrics Bulletin 2 (1946) 110-114). The prior counts as an additional measurement. A
    direction is open if its standard deviation exceeds a unit, a factor of e, or twice that of the
    prior; a parameter with at least ``part`` of it is part of it. ``level``: probability of the
    intervals.
    """
    problem, F = best.problem, best.x.size
    prior_sd = column(problem.parameters, "prior_sd") / problem.unit
    wide = np.where(np.isfinite(prior_sd), np.maximum(2 * prior_sd, 1.0), problem.natural)
    tempering = best.scale_rad**2 * best.inflation
    prior_precision = tempering * best.prior * np.outer(wide, wide)
    slopes, z2 = best.slopes * wide, (best.error / (OUTLIER_SD * best.scale_rad)) ** 2
    score = (best.error / np.sqrt(1 + z2))[:, None] * slopes
    curvature = (slopes / (1 + z2[:, None]) ** 1.5).T @ slopes + prior_precision
    noise, spread = float(np.mean(best.error**2 / (1 + z2))), tempering * prior_precision
    independent = noise * slopes.T @ slopes + spread
    effective, spans = 0.0, []
    for error, part_of_score in zip(best.residuals, problem.by_trace(score), strict=True):
        time = correlation_samples(error)
        spans.append(bandwidth(error.size, time))
        spread = spread + long_run(part_of_score, spans[-1])
        effective += error.size / time
    parts, freedoms = spread[None], np.array([max(effective - F, 1.0)])
    if repeating:
        of_angle, coefficients = repeating_error(best, best.prior * tempering)
        parts = np.concatenate([parts, of_angle * np.outer(wide, wide)])
        freedoms = np.append(freedoms, np.maximum(coefficients, 1.0))
        spread = parts.sum(axis=0)
    eigen, directions = np.linalg.eigh(curvature)
    least = 1e-12 * max(eigen[-1], 1e-300)
    eigen = np.maximum(eigen, least)
    both = np.stack([spread, independent])
    along = np.einsum("ik,cij,jk->ck", directions, both, directions).max(axis=0)
    # curvature without information is round-off of either sign
    along_sd = np.where(eigen > least, np.sqrt(np.maximum(along, 0.0)) / eigen, np.inf)
    determined = along_sd < 1.0
    inverse = directions[:, determined] / eigen[determined] @ directions[:, determined].T
    covariance, at_least = inverse @ both @ inverse
    raised = _ratio(np.diag(at_least), np.diag(covariance))
    raised = np.sqrt(np.maximum(raised, 1.0))
    covariance = covariance * np.outer(raised, raised)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    variances = np.einsum("ij,cjk,ki->ci", inverse, parts, inverse)
    weights = _ratio(variances**2, np.maximum(variances.sum(axis=0), 1e-300) ** 2)
    freedom = _ratio(np.ones(F), (weights / freedoms[:, None]).sum(axis=0))
    student = stdtrit(freedom, 0.5 + level / 2)
    quantile = student * fixed_b(float(np.mean(spans)), best.error.size, level)
    return Uncertainty(
        covariance=covariance * np.outer(wide, wide),
        half_width=np.asarray(quantile * sd * wide),
        open_directions=tuple(
            tuple(int(i) for i in np.flatnonzero(np.abs(directions[:, k]) > part))
            for k in np.flatnonzero(~determined)
        ),
        level=level,
    )


def _ratio(variance: Array, least: Array) -> Array:
    return np.divide(variance, least, out=np.ones_like(variance), where=least > 0)


def intervals(best: Fit, spread: Uncertainty) -> dict[str, tuple[float, float]]:
    """Intervals of the fitted parameters, by name, with their prior if they have one.

    Symmetric as searched, and of a servo without a motor wide enough for all other minima that fit
    the recordings as well; from bound to bound in a direction that is not determined. An upper end
    at the bound is infinite.
    """
    problem, (low, high) = best.problem, best.problem.box
    points = best.x[None]
    if problem.ties is None and all("." not in name for name in problem.names):
        points = np.vstack([points, best.as_good(spread.least_loss)])
    lower = np.minimum(points.min(axis=0), best.x - spread.half_width)
    upper = np.maximum(points.max(axis=0), best.x + spread.half_width)
    for k in spread.undetermined:
        lower[k], upper[k] = low[k], high[k]
    ends = problem.values(np.clip([lower, upper], low, high))
    ends[1, upper >= high] = np.inf
    return {p.name: (float(ends[0, k]), float(ends[1, k])) for k, p in enumerate(best.parameters)}


def beyond_data_sheet(
    motor: Fit,
    ends: Mapping[str, tuple[float, float]],
    servo: Servo,
    *,
    implausible_sd: float = 4.0,
) -> dict[str, tuple[float, float]]:
    """Wider intervals of the gains where the stall torque is implausible for the data sheet.

    The load sets the scale of both. If a stated load is wrong, the gains are as wrong as the stall
    torque, and their intervals extend to the values that belong to that of the data sheet: where it
    is ``implausible_sd`` standard deviations of its prior away.
    """
    if LINE[0] not in motor.names or motor.problem.traces[0].load is PER_INERTIA:
        return {}
    k = motor.names.index(LINE[0])
    factor = servo.max_torque_Nm / float(motor.values[k])
    if abs(np.log(factor)) < implausible_sd * motor.parameters[k].prior_sd:
        return {}
    both = ((gain, ends[gain]) for gain in GAINS if gain in ends)
    return {gain: (min(low, low * factor), max(up, up * factor)) for gain, (low, up) in both}
