"""Uncertainty of a fit with correlated residuals, and 90 % intervals.

Ends of intervals are infinite where the recordings set no bound.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from sim2real.arrays import Array
from sim2real.identification.fit import Fit, fit, gains
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.repeating_error import repeating_error
from sim2real.inference.correlated_noise import bandwidth, correlation_samples, fixed_b, long_run
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.trace import Trace

GAINS = ("kp_Nm_per_rad", "kd_Nms_per_rad")
_CHI2_90 = 6.251
"""90 % quantile of chi-square with three degrees of freedom, as regions may be disconnected."""


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

    @property
    def undetermined(self) -> set[int]:
        """Indices of the parameters in open directions."""
        return {k for direction in self.open_directions for k in direction}


def uncertainty(
    best: Fit,
    units: Array,
    traces: Sequence[Trace] = (),
    *,
    probability: float = 0.90,
    open_sd: float = 1.0,
    part: float = 0.25,
) -> Uncertainty:
    """Sandwich covariance of a robust fit whose residuals are correlated in time.

    The covariance is inv(H) S inv(H): H the curvature of the loss, S the long-run covariance of its
    gradient (Bartlett weights: Newey and West, Econometrica 55 (1987) 703-708). It is never taken
    smaller than the covariance for independent residuals. With ``traces``, errors that repeat with
    the angle add to S (``repeating_error``). Intervals use Student's t with the effective number
    of samples and, of repeating errors, of coefficients, combined for each parameter
    (Satterthwaite, Biometrics Bulletin 2 (1946) 110-114). The prior counts as an additional
    measurement.

    Args:
        best: The fit.
        units: Natural units of the free parameters, shape (F,).
        traces: The fitted recordings; none if no errors repeat with the angle.
        probability: Probability of the intervals.
        open_sd: Standard deviation in natural units above which a direction is open.
        part: Share of an open direction from which a parameter counts as part of it.
    """
    size = OUTLIER_SD * best.scale_rad
    curvature = np.zeros((units.size, units.size))
    plain = np.zeros_like(curvature)
    spread = np.zeros_like(curvature)
    squares, effective, spans = 0.0, 0.0, []
    for error, slopes in zip(best.residuals, best.jacobians, strict=True):
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
    if best.prior is not None:
        prior_precision = best.tempering * best.prior * np.outer(units, units)
        curvature += prior_precision
        spread += best.tempering * prior_precision
    parts, freedoms = spread[None], np.array([max(effective - units.size, 1.0)])
    if traces:
        slopes = np.concatenate(best.jacobians) * units
        repeating, coefficients = repeating_error(best, traces, slopes, prior_precision)
        parts = np.concatenate([parts, repeating])
        freedoms = np.append(freedoms, np.maximum(coefficients, 1.0))
        spread = parts.sum(axis=0)
    samples = sum(error.size for error in best.residuals)
    level, directions = np.linalg.eigh(curvature)
    least = 1e-12 * max(level[-1], 1e-300)
    level = np.maximum(level, least)
    independent = (squares / samples) * plain + best.tempering * prior_precision
    along = np.maximum(
        np.einsum("ik,ij,jk->k", directions, spread, directions),
        np.einsum("ik,ij,jk->k", directions, independent, directions),
    )
    # curvature without information is round-off of either sign
    along_sd = np.where(level > least, np.sqrt(np.maximum(along, 0.0)) / level, np.inf)
    determined = along_sd < open_sd
    inverse = directions[:, determined] / level[determined] @ directions[:, determined].T
    at_least = inverse @ independent @ inverse
    covariance = _raised_to(inverse @ spread @ inverse, at_least)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    variances = np.einsum("ij,cjk,ki->ci", inverse, parts, inverse)
    weights = _ratio(variances**2, np.maximum(variances.sum(axis=0), 1e-300) ** 2)
    freedom = _ratio(np.ones(units.size), (weights / freedoms[:, None]).sum(axis=0))
    student = stdtrit(freedom, 0.5 + probability / 2)
    quantile = student * fixed_b(float(np.mean(spans)), samples)
    correlation = covariance / np.where(np.outer(sd, sd) > 0, np.outer(sd, sd), 1.0)
    return Uncertainty(
        sd=sd * units,
        correlation=correlation,
        half_width=quantile * sd * units,
        open_directions=tuple(
            tuple(int(i) for i in np.flatnonzero(np.abs(directions[:, k]) > part))
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


def intervals(
    best: Fit,
    rivals: list[Fit],
    spread: Uncertainty,
    units: Array,
    fitted: list[Trace],
    *,
    largest_symmetric: float = 0.15,
) -> dict[str, tuple[float, float]]:
    """90 % intervals of gains, latency and, if it is free, inertia, by name.

    Symmetric ends from the covariance if that is small and there is no rival outside; else by
    profile likelihood. An upper end is infinite if the recordings do not determine it; ends are
    within the bounds. An interval includes all rivals that fit the recordings equally well.

    Args:
        best: The fit.
        rivals: Fits of very different gains.
        spread: Covariance of the fit.
        units: Natural unit of each fitted parameter, shape (F,).
        fitted: The recordings.
        largest_symmetric: Half-width in natural units above which symmetric ends are not used.
    """
    equal = as_good(rivals, best, spread)
    result = {p.name: (p.low, np.inf) for p in gains(best.row, best.inertia)}
    for k, p in enumerate(best.parameters):
        value, half = float(best.values[k]), float(spread.half_width[k])
        ends = (max(value - half, p.low), min(value + half, p.high))
        values = [float(rival.row[COLUMNS.index(p.name)]) for rival in (best, *equal)]
        elsewhere = any(abs(other - value) > half for other in values)
        if k in spread.undetermined or elsewhere or half > largest_symmetric * units[k]:
            first = max(min(half, units[k]), 0.1 * units[k]) / 2
            ends = (
                _profiled(best, k, -first, p.low, fitted, spread.inflation),
                _profiled(best, k, first, p.high, fitted, spread.inflation),
            )
        ends = (min(ends[0], *values), max(ends[1], *values))
        result[p.name] = (ends[0], np.inf if ends[1] == p.high else ends[1])
    return result


def as_good(others: Sequence[Fit], best: Fit, spread: Uncertainty) -> list[Fit]:
    """The fits that explain the recordings as well as the best one, at 90 % confidence."""
    return [other for other in others if _excess(other, best, spread.inflation) < _CHI2_90]


def symmetric_intervals(
    best: Fit, spread: Uncertainty, units: Array
) -> dict[str, tuple[float, float]]:
    """90 % intervals from the covariance, with infinite upper ends in open directions."""
    result = {}
    for k, (p, value) in enumerate(zip(best.parameters, best.values, strict=True)):
        half = float(spread.half_width[k])
        unbounded = k in spread.undetermined or half > units[k]
        ends = (p.low, np.inf) if unbounded else (float(value) - half, float(value) + half)
        result[p.name] = (max(ends[0], p.low), ends[1])
    return result


def motor_intervals(motor: MotorFit, spread: Uncertainty) -> dict[str, tuple[float, float]]:
    """90 % intervals of a motor's parameters, with their prior.

    Symmetric in the searched variables: the logarithms of gains, torque and speed.
    """
    result = {}
    for k, (p, fitted_value) in enumerate(zip(motor.fit.parameters, motor.fit.values, strict=True)):
        value, half = float(fitted_value), float(spread.half_width[k])
        ends = value - half, value + half
        if p.log:
            ends = value * float(np.exp(-half / value)), value * float(np.exp(half / value))
        top = np.inf if ends[1] >= p.high else ends[1]
        result[p.name] = (min(max(ends[0], p.low), value), max(top, value))
    return result


def beyond_data_sheet(
    motor: MotorFit,
    ends: Mapping[str, tuple[float, float]],
    servo: Servo,
    *,
    implausible_sd: float = 4.0,
) -> dict[str, tuple[float, float]]:
    """Wider intervals of the gains where the stall torque is implausible for the data sheet.

    The load sets the scale of both. If a stated load is wrong, the gains are as wrong as the stall
    torque, and their intervals extend to the values that belong to that of the data sheet.

    Args:
        motor: The fit.
        ends: Intervals of the gains, by name.
        servo: The data sheet.
        implausible_sd: Deviation of the stall torque from it, in standard deviations of its prior.
    """
    name = "motor.stall_torque_Nm"
    if name not in motor.fit.names or motor.problem.traces[0].load is PER_INERTIA:
        return {}
    k = motor.fit.names.index(name)
    factor = servo.max_torque_Nm / float(motor.fit.values[k])
    if abs(np.log(factor)) < implausible_sd * motor.fit.parameters[k].prior_sd:
        return {}
    wider = {}
    for gain in GAINS:
        low, high = ends[gain]
        wider[gain] = (min(low, low * factor), max(high, high * factor))
    return wider


def _profiled(
    best: Fit,
    k: int,
    first: float,
    limit: float,
    fitted: list[Trace],
    inflation: float,
    *,
    steps: int = 24,
    bisections: int = 3,
) -> float:
    """End of the interval of one parameter, or ``limit`` if the recordings do not determine it.

    Profile likelihood: the parameter is moved by increasing steps, starting with ``first``, and the
    others are refitted, until twice the decrease of the log-likelihood exceeds ``_CHI2_90``; then
    the end is bisected. The proportional gain is moved by factors, the others by differences.
    """
    value, name = float(best.values[k]), best.names[k]
    row = best.row.copy()

    def moved(step: float) -> float:
        trial = value * float(np.exp(step / value)) if name == COLUMNS[0] else value + step
        return min(trial, limit) if first > 0 else max(trial, limit)

    def accounts(trial: float) -> bool:
        row[COLUMNS.index(name)] = trial
        scaled = {p.name: p for p in gains(row, best.inertia)}
        others = [scaled.get(p.name, p) for p in best.parameters if p.name != name]
        profile = fit(fitted, row, others, rounds=1, evaluations=8)
        if _excess(profile, best, inflation) > _CHI2_90:
            return False
        row[:] = profile.row
        return True

    inside, outside = 0.0, first
    for _ in range(steps):
        if not accounts(moved(outside)):
            break
        if moved(outside) == limit:
            return limit
        inside, outside = outside, 2 * outside
    for _ in range(bisections):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if accounts(moved(middle)) else (inside, middle)
    return moved(0.5 * (inside + outside))


def _excess(other: Fit, best: Fit, inflation: float) -> float:
    """Twice the log-likelihood by which ``best`` exceeds ``other``, for correlated residuals."""
    rise = other.loss(best.scale_rad) - best.loss(best.scale_rad)
    return rise / best.scale_rad**2 / max(inflation, 1.0)
