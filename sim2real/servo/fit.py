"""Least squares on simulated angles: gains, latency and, where wanted, inertia left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sim2real.servo.symbolic import PARAMETERS, simulate
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

LOW = np.array([1e-9, 0.0, 0.0, -0.9])
"""Smallest values, in units of the load's inertia for kp, kd and inertia."""
HIGH = np.array([1.6e5, 1.6e3, 0.5, 20.0])
"""Largest values, likewise; latency in s."""
OUTLIER_SD = 3.0
"""Residuals beyond so many standard deviations lose weight."""
_SAME_SCALE = 0.05


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
        prior: Precision of what was believed of the free parameters, shape (F, F), if anything.
        tempering: Variance in rad2 that one sample of the residual had beside that prior.
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
    prior: Array | None = None
    tempering: float = 1.0

    def loss(self, scale_rad: float) -> float:
        """Robust loss for a given scale of the residual, in rad2; about the sum of squares."""
        return robust_loss(self.residuals, scale_rad)

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

    x, converged = search(
        evaluate,
        parameters[index] / unit,
        (low[index] / unit, high[index] / unit),
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


def search(
    evaluate: Callable[[Array], tuple[Array, Array]],
    start: Array,
    box: tuple[Array, Array],
    *,
    rounds: int,
    evaluations: int,
) -> tuple[Array, bool]:
    """Least squares, first plain, then robust (soft L1) with the scale taken anew until it stays.

    Args:
        evaluate: Residuals (n,) and their derivatives (n, F) at a point (F,).
        start: Where to begin, shape (F,).
        box: Smallest and largest values, each of shape (F,).
        rounds: Most robust rounds after the plain one.
        evaluations: Most evaluations in one round.

    Returns:
        The minimum, shape (F,), and whether the search converged to it.
    """
    cache: dict[bytes, tuple[Array, Array]] = {}

    def at(x: Array) -> tuple[Array, Array]:
        key = x.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = evaluate(x)
        return cache[key]

    margin = 1e-9 * (box[1] - box[0])
    point, scale, converged = start, 1.0, True
    for number in range(rounds + 1):
        if number:
            before, scale = scale, robust_scale(at(point)[0])
            if number > 1 and abs(scale / before - 1) < _SAME_SCALE:
                break
        result = least_squares(
            lambda x: at(x)[0],  # type: ignore[misc]
            np.clip(point, box[0] + margin, box[1] - margin),
            jac=lambda x: at(x)[1],  # type: ignore[misc]
            bounds=box,
            loss="soft_l1" if number else "linear",
            f_scale=OUTLIER_SD * scale,
            method="dogbox",
            xtol=1e-9,
            ftol=1e-9,
            gtol=1e-12,
            max_nfev=evaluations,
        )
        point, converged = result.x, result.status > 0
    return point, converged


def robust_loss(errors: Sequence[Array], scale_rad: float) -> float:
    """Soft L1 loss of residuals of a given scale, in rad2; about their sum of squares."""
    size2 = (OUTLIER_SD * scale_rad) ** 2
    return sum(float(np.sum(np.sqrt(1 + e**2 / size2) - 1)) for e in errors) * 2 * size2


def rms(errors: Sequence[Array]) -> float:
    """Root mean square over all arrays; 0 where there is no sample."""
    count = sum(error.size for error in errors)
    return float(np.sqrt(sum(np.sum(error**2) for error in errors) / max(count, 1)))


def robust_scale(error: Array) -> float:
    """Standard deviation that a tenth of wild samples cannot spoil, never 0.

    Solves mean(min((error / scale)^2, 9)) = 0.995, its value for normal errors: Huber's proposal
    2 (Annals of Mathematical Statistics 35 (1964) 73-101) with the limit at 3 standard deviations.
    """
    scale = max(float(np.sqrt(np.mean(error**2))), 1e-9)
    for _ in range(60):
        limited = np.minimum((error / scale) ** 2, OUTLIER_SD**2)
        scale = max(scale * float(np.sqrt(np.mean(limited) / 0.995)), 1e-9)
    return scale
