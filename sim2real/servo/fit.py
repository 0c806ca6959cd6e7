"""Least squares on simulated angles: gains, latency and, where wanted, inertia left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.inference.least_squares import (
    OUTLIER_SD,
    minimise_robustly,
    robust_loss,
    robust_scale,
)
from sim2real.servo.symbolic import PARAMETERS, simulate
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

LOW = np.array([1e-9, 0.0, 0.0, -0.9])
"""Smallest values, in units of the load's inertia for kp, kd and inertia."""
HIGH = np.array([1.6e5, 1.6e3, 0.5, 20.0])
"""Largest values, likewise; latency in s."""


@dataclass(frozen=True)
class Fit:
    """A fit that has converged, or says that it has not.

    Attributes:
        names: Names of all N parameters; the first four are ``symbolic.PARAMETERS``.
        parameters: Their values, shape (N,).
        low: Their smallest values, shape (N,).
        high: Their largest values, shape (N,).
        free: Indices of those that were fitted.
        scale_rad: Robust standard deviation of the residual.
        residuals: Simulated minus measured angle at the used samples, one array a trace.
        jacobians: Its derivatives by the free parameters, one array (n, free) a trace.
        converged: Whether the search ended at a minimum.
        inertia: The stated inertia, kg m2.
    """

    names: tuple[str, ...]
    parameters: Array
    low: Array
    high: Array
    free: tuple[int, ...]
    scale_rad: float
    residuals: tuple[Array, ...]
    jacobians: tuple[Array, ...]
    converged: bool
    inertia: float

    def loss(self, scale_rad: float) -> float:
        """Robust loss for a given scale of the residual, in rad2; about the sum of squares."""
        return robust_loss(np.concatenate(self.residuals), OUTLIER_SD * scale_rad)

    @property
    def at_bound(self) -> tuple[int, ...]:
        """Indices of the free parameters that ended on a bound."""
        room = np.minimum(self.parameters - self.low, self.high - self.parameters)
        return tuple(k for k in self.free if room[k] < 1e-6 * (self.high[k] - self.low[k]))


def bounds(inertia: float) -> tuple[Array, Array]:
    """Smallest and largest value of each parameter for a load of ``inertia`` kg m2."""
    unit = np.array([inertia, inertia, 1.0, inertia])
    return LOW * unit, HIGH * unit


def residuals(
    parameters: Array, traces: Sequence[Trace]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Simulated minus measured angle and its derivatives by all parameters, for each trace."""
    errors, slopes = [], []
    for trace in traces:
        angle, slope = simulate(parameters, trace.load, trace.t, trace.command)
        errors.append((angle - trace.position)[trace.used])
        slopes.append(slope[trace.used])
    return tuple(errors), tuple(slopes)


def fit(
    traces: Sequence[Trace],
    start: Array,
    *,
    free: tuple[int, ...] = (0, 1, 2),
    rounds: int = 3,
    evaluations: int = 60,
) -> Fit:
    """Fit the free parameters to all traces at once.

    Args:
        traces: The joint's recordings.
        start: All parameters, shape (4,); those not free stay as they are.
        free: Indices of the parameters to fit.
        rounds: Most robust rounds after the plain one.
        evaluations: Most simulations of all traces in one round.
    """
    inertia = traces[0].load.inertia_kgm2
    low, high = bounds(inertia)
    index = list(free)
    unit = np.maximum(np.abs(start), [1e-6 * inertia, 1e-2 * inertia, 1e-2, 1e-1 * inertia])[index]
    parameters = np.clip(start, low, high).astype(np.float64)

    def evaluate(x: Array) -> tuple[Array, Array]:
        trial = parameters.copy()
        trial[index] = x * unit
        errors, slopes = residuals(trial, traces)
        return np.concatenate(errors), np.concatenate(slopes)[:, index] * unit

    x, converged = minimise_robustly(
        evaluate,
        parameters[index] / unit,
        low[index] / unit,
        high[index] / unit,
        rounds=rounds,
        evaluations=evaluations,
    )
    parameters[index] = x * unit
    errors, slopes = residuals(parameters, traces)
    return Fit(
        names=PARAMETERS,
        parameters=parameters,
        low=low,
        high=high,
        free=free,
        scale_rad=robust_scale(np.concatenate(errors)),
        residuals=errors,
        jacobians=tuple(slope[:, index] for slope in slopes),
        converged=converged,
        inertia=inertia,
    )
