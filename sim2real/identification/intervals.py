"""90 % intervals, with infinite ends where the recordings set no bound."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.fit import Fit, fit, gains
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.uncertainty import Uncertainty
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_CHI2_90 = 6.251
"""90 % quantile of chi-square with three degrees of freedom, as regions may be disconnected."""


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
    undetermined = {k for direction in spread.open_directions for k in direction}
    result = {p.name: (p.low, np.inf) for p in gains(best.row, best.inertia)}
    for k, p in enumerate(best.parameters):
        value, half = float(best.values[k]), float(spread.half_width[k])
        ends = (max(value - half, p.low), min(value + half, p.high))
        values = [float(rival.row[COLUMNS.index(p.name)]) for rival in (best, *equal)]
        elsewhere = any(abs(other - value) > half for other in values)
        if k in undetermined or elsewhere or half > largest_symmetric * units[k]:
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
    undetermined = {k for direction in spread.open_directions for k in direction}
    result = {}
    for k, (p, value) in enumerate(zip(best.parameters, best.values, strict=True)):
        half = float(spread.half_width[k])
        unbounded = k in undetermined or half > units[k]
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
    others are refitted, until twice the decrease of the log-likelihood exceeds ``_CHI2_90``. The
    proportional gain is moved by factors, the others by differences.
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
