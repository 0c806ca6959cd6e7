"""The torque that a fitted servo lacks, from what it leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs, savgol_filter

Array = NDArray[np.float64]

WINDOW_S = 0.18
ORDER = 3


def residual_torque(
    t: Array, residual: Array, servo: tuple[float, float, float], noise_rad: float
) -> tuple[Array, Array]:
    """Torque to add to the model so that it follows the measurement, and its standard deviation.

    ``-(inertia r'' + kd r' + stiffness r)``, r smoothed by local polynomials: Savitzky, Golay,
    Analytical Chemistry 36 (1964) 1627-1639.

    Args:
        t: Times in s, shape (T,).
        residual: Simulated minus measured angle in rad, NaN where none was measured, shape (T,).
        servo: Inertia in kg m2, kd in N m s/rad, and stiffness (kp and the weight's) in N m/rad.
        noise_rad: Standard deviation of the measurement noise.

    Returns:
        Torque in N m, shape (T,), and its standard deviation, shape (T,).
    """
    step = float(np.median(np.diff(t)))
    length = _length(step, t.size)
    grid = t[0] + step * np.arange(int(round((t[-1] - t[0]) / step)) + 1)
    known = np.isfinite(residual)
    even = np.interp(grid, t[known], residual[known])
    torque: Array = np.zeros(grid.size)
    taps: Array = np.zeros(length)
    for order, weight in zip((2, 1, 0), servo, strict=True):
        torque -= weight * savgol_filter(even, length, ORDER, deriv=order, delta=step)
        taps += weight * savgol_coeffs(length, ORDER, deriv=order, delta=step)
    sd = noise_rad * float(np.sqrt(np.sum(taps**2)))
    return np.interp(t, grid, torque), np.full(t.size, sd)


def smooth_speed(t: Array, position: Array) -> Array:
    """Speed in rad/s by local polynomials, shape (T,), of angles with NaN where missing."""
    return _smoothed(t, position, 1)


def smooth(t: Array, position: Array) -> Array:
    """Angles in rad by local polynomials, shape (T,), of angles with NaN where missing."""
    return _smoothed(t, position, 0)


def _smoothed(t: Array, position: Array, derivative: int) -> Array:
    step = float(np.median(np.diff(t)))
    known = np.isfinite(position)
    even = np.interp(t, t[known], position[known])
    length = _length(step, t.size)
    return np.asarray(savgol_filter(even, length, ORDER, deriv=derivative, delta=step))


def _length(step: float, samples: int) -> int:
    half = max(2, round(WINDOW_S / step / 2))
    return int(min(2 * half + 1, samples - 1 + samples % 2))
