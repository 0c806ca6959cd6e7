"""What errors that repeat with the angle add to the uncertainty of a fit.

Cogging, friction that varies with the angle and a nonlinear sensor make the same error
at every pass of an angle. However often the joint passes, such errors do not average out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from sim2real.arrays import Array
from sim2real.identification.problem import Fit
from sim2real.inference.least_squares import OUTLIER_SD
from sim2real.servo.parameters import beyond_load
from sim2real.servo.trace import Trace


def repeating_error(
    best: Fit,
    prior: Array,
    *,
    slow_per_rad: float = 2.0,
    finest_per_rad: float = 12.5,
    most_waves: int = 40,
) -> tuple[Array, Array]:
    """Covariances of the gradient of the loss by errors that are functions of the angle.

    The residual contains an error of the measured angle and a torque that act through the closed
    loop of gains, inertia and gravity, both random functions of the simulated angle: Fourier series
    over the visited range with independent coefficients. Each has one prior variance for slow waves
    (eccentric sensors, gravity: up to ``slow_per_rad`` cycles per radian) and one for fine ones (up
    to 79 a turn, cogging behind gears); the four are estimated from the residual by
    ``variance_components``. A wave that the residual shows counts with its own power, as cogging is
    a single wave, and one that the fit has absorbed with the variance of its kind. Phases are
    arbitrary: the cosine and the sine of a wave share its power.

    ``prior`` (F, F) is the precision of the prior by ``x``, times the variance of a residual.

    Returns:
        The covariance of each kind of error, shape (C, F, F), and the effective number of
        coefficients from which its power is estimated, shape (C,).
    """
    error, slopes = best.error, best.slopes
    traces = [trace for trace in best.problem.traces if trace.used.any()]
    none = np.zeros((0, *prior.shape)), np.zeros(0)
    if best.scale_rad <= 0.0 or not traces:
        return none
    errors = [e for e in best.residuals if e.size]
    angles = [t.simulated(e) for t, e in zip(traces, errors, strict=True)]
    low, high = min(a.min() for a in angles), max(a.max() for a in angles)
    if high - low < best.scale_rad:
        return none
    length = 1.3 * (high - low)  # a longer period than the range lets the ends differ
    waves = np.arange(1, np.clip(round(finest_per_rad * length), 1, most_waves) + 1)
    slow = np.tile(waves / length <= slow_per_rad, 2)
    of_angle, of_torque = [], []
    for trace, angle in zip(traces, angles, strict=True):
        phase = 2 * np.pi * np.outer(angle - low, waves) / length
        series = np.hstack([np.cos(phase), np.sin(phase)])
        of_angle.append(series[trace.used])
        of_torque.append(_through_loop(best, trace, series)[trace.used])
    kinds = [np.vstack(of_angle), np.vstack(of_torque)]
    groups = [kind[:, part] for kind in kinds for part in (slow, ~slow) if part.any()]
    weight = (1 + (error / (OUTLIER_SD * best.scale_rad)) ** 2)[:, None] ** -1.5
    root = np.sqrt(weight)
    squares, freedom = variance_components(
        root[:, 0] * error, root * slopes, prior, [root * group for group in groups]
    )
    covariances = []
    for square, group in zip(squares, groups, strict=True):
        power = np.tile(square.reshape(2, -1).mean(axis=0), 2)
        gradient = (weight * slopes).T @ group
        covariances.append(power * gradient @ gradient.T)
    return np.array(covariances), freedom


def variance_components(
    error: Array, slopes: Array, prior: Array, groups: Sequence[Array], *, rounds: int = 15
) -> tuple[list[Array], Array]:
    """Expected squares of the coefficients of groups of functions in a residual with white noise.

    Each group has one prior variance. Restricted maximum likelihood, which allows for what the fit
    has absorbed (Patterson and Thompson, Biometrika 58 (1971) 545-554), by fixed-point steps
    (MacKay, Neural Computation 4 (1992) 415-447): a variance is the sum of squared coefficients
    over their effective number.

    Of a residual (n,), its derivatives by the fitted parameters (n, F), the precision of their
    prior times the variance of a residual (F, F), and functions of each group (n, m).

    Returns:
        Expected squares of the coefficients of each group given the residual, shapes (m,): their
        mean is the prior variance of the group. The effective number of coefficients of each, (C,).
    """
    group = np.repeat(np.arange(len(groups)), [g.shape[1] for g in groups])
    start = np.cumsum(np.bincount(group)) - np.bincount(group)
    functions = np.hstack(groups)
    curvature = slopes.T @ slopes + prior
    curvature += 1e-12 * np.trace(curvature) * np.eye(len(prior))
    both = np.column_stack([functions, error])
    both -= slopes @ np.linalg.solve(curvature, slopes.T @ both)
    products, target = functions.T @ both[:, :-1], functions.T @ both[:, -1]
    products = 0.5 * (products + products.T)
    square = float(error @ both[:, -1])
    noise = square / error.size
    variances, freedom = np.full(len(groups), 0.3 * noise), np.zeros(len(groups))
    for _ in range(rounds):
        variance = np.maximum(variances[group], 1e-16 * noise)
        sd = np.sqrt(variance)
        reduced = sd[:, None] * products * sd / noise
        remaining = np.linalg.inv(np.eye(group.size) + reduced)
        coefficients = sd * (remaining @ (sd * target)) / noise
        freedom = np.add.reduceat(1 - np.diag(remaining), start)
        variances = np.add.reduceat(coefficients**2, start) / np.maximum(freedom, 1e-9)
        left = square - 2 * coefficients @ target + coefficients @ products @ coefficients
        free = max(error.size - len(prior) - freedom.sum(), 1.0)
        noise = max(left / free, 1e-3 * noise)
    squares = coefficients**2 + variance * np.diag(remaining)
    return np.split(squares, start[1:]), freedom


def _through_loop(best: Fit, trace: Trace, torque: Array) -> Array:
    """Angle in rad by torques (T, m), in units of the proportional gain, on a servo at rest."""
    kp, kd = (float(x) for x in best.row[:2])
    inertia = trace.load.inertia_kgm2 + float(beyond_load(best.row))
    rate = np.zeros((3, 3))  # of angle, speed and the held torque
    rate[0, 1] = 1.0
    rate[1] = np.array([-kp - trace.load.gravity_Nm, -kd, kp]) / inertia
    step = expm(trace.period_s * rate)[:2]  # a torque is held for a sampling period
    state, angle = np.zeros((3, torque.shape[1])), np.empty_like(torque)
    for row, held in zip(angle, torque, strict=True):  # quicker than loading scipy.signal
        row[:], state[2] = state[0], held
        state[:2] = step @ state
    return angle
