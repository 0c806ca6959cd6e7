"""90 % intervals, infinite where the recordings set no bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim2real.servo.fit import Fit, fit
from sim2real.servo.motor_fit import MotorFit
from sim2real.servo.symbolic import PARAMETERS
from sim2real.servo.trace import Trace
from sim2real.servo.uncertainty import Uncertainty

Array = NDArray[np.float64]

_NOT_LINEAR = 0.15
"""Half-width, in natural units, from which symmetric ends are not trusted."""
_STEPS, _BISECTIONS = 24, 3
_CHI2_90 = 6.251
"""90 % quantile of chi-square with three degrees of freedom: the region may be of many islands."""


def intervals(
    best: Fit, rivals: list[Fit], spread: Uncertainty, units: Array, fitted: list[Trace]
) -> dict[str, tuple[float, float]]:
    """90 % interval of every plain parameter and of inertia, if that is free, by name.

    Symmetric ends from the covariance where that is small; by profile likelihood elsewhere. An
    upper end is infinite where the recordings set none; no end is below what is possible. An
    interval spans every rival that accounts for the recordings as well.
    """
    low, high = best.low, best.high
    equal = [one for one in rivals if _excess(one, best, spread.inflation) < _CHI2_90]
    wide = {k for direction in spread.open_directions for k in direction}
    result = {PARAMETERS[k]: (float(low[k]), float(np.inf)) for k in range(3) if k not in best.free}
    for k, index in enumerate(best.free):
        value, half = float(best.parameters[index]), float(spread.half_width[k])
        ends = (max(value - half, float(low[index])), min(value + half, float(high[index])))
        if k in wide or half > _NOT_LINEAR * units[k]:
            first = max(min(half, units[k]), 0.1 * units[k]) / 2
            ends = (
                _profiled(best, index, -first, float(low[index]), fitted, spread.inflation),
                _profiled(best, index, first, float(high[index]), fitted, spread.inflation),
            )
        values = [float(one.parameters[index]) for one in (best, *equal)]
        ends = (min(ends[0], *values), max(ends[1], *values))
        result[PARAMETERS[index]] = (ends[0], np.inf if ends[1] == high[index] else ends[1])
    return result


def symmetric_intervals(
    best: Fit, spread: Uncertainty, units: Array
) -> dict[str, tuple[float, float]]:
    """90 % intervals from the covariance alone, infinite upwards along directions not seen."""
    wide = {k for direction in spread.open_directions for k in direction}
    result = {}
    for k, index in enumerate(best.free):
        value, half = float(best.parameters[index]), float(spread.half_width[k])
        open_ = k in wide or half > units[k]
        ends = (float(best.low[index]), np.inf) if open_ else (value - half, value + half)
        result[best.names[index]] = (max(ends[0], float(best.low[index])), ends[1])
    return result


def motor_intervals(motor: MotorFit, spread: Uncertainty) -> dict[str, tuple[float, float]]:
    """90 % intervals of a motor's parameters, what was believed of them included.

    Symmetric in what was searched: in the logarithm of gains, torque and speed.
    """
    fit, result = motor.fit, {}
    for k, index in enumerate(fit.free):
        value, half = float(fit.parameters[index]), float(spread.half_width[k])
        ends = value - half, value + half
        if motor.log[k]:
            ends = value * float(np.exp(-half / value)), value * float(np.exp(half / value))
        low, high = float(fit.low[index]), float(fit.high[index])
        top = np.inf if ends[1] >= high else ends[1]
        result[fit.names[index]] = (min(max(ends[0], low), value), max(top, value))
    return result


def _profiled(
    best: Fit, index: int, first: float, limit: float, fitted: list[Trace], inflation: float
) -> float:
    """End of the interval of one parameter: ``limit`` where the recordings set none before it.

    Profile likelihood: the parameter is moved by growing steps, from ``first`` on, the others
    refitted from where they were, until twice the fall of the log-likelihood exceeds ``_CHI2_90``.
    The proportional gain moves by factors, the others by differences.
    """
    value = float(best.parameters[index])
    others = tuple(k for k in best.free if k != index)
    held = best.parameters.copy()

    def moved(step: float) -> float:
        trial = value * float(np.exp(step / value)) if index == 0 else value + step
        return min(trial, limit) if first > 0 else max(trial, limit)

    def accounts(trial: float) -> bool:
        held[index] = trial
        other = fit(fitted, held, free=others, rounds=1, evaluations=8)
        if _excess(other, best, inflation) > _CHI2_90:
            return False
        held[:] = other.parameters
        return True

    inside, outside = 0.0, first
    for _ in range(_STEPS):
        if not accounts(moved(outside)):
            break
        if moved(outside) == limit:
            return limit
        inside, outside = outside, 2 * outside
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if accounts(moved(middle)) else (inside, middle)
    return moved(0.5 * (inside + outside))


def _excess(other: Fit, best: Fit, inflation: float) -> float:
    """Twice the log-likelihood by which ``best`` exceeds ``other``, for correlated residuals."""
    rise = other.loss(best.scale_rad) - best.loss(best.scale_rad)
    return rise / best.scale_rad**2 / max(inflation, 1.0)
