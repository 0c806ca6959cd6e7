"""The servo linearised about its own motion: from a torque on the shaft to the angle, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, savgol_coeffs, savgol_filter

Array = NDArray[np.float64]

Response = tuple[Array, Array]
"""Numerator and denominator of a digital filter, as ``scipy.signal.lfilter`` takes them."""
WINDOW_S, ORDER = 0.18, 3
"""Length and order of the local polynomials that smooth."""


def response(inertia: float, kd: float, stiffness: float, step_s: float) -> Response:
    """Filter from torque in N m to angle in rad, 1 / (I s2 + kd s + stiffness).

    By the bilinear transform: Oppenheim, Schafer, Discrete-Time Signal Processing, 3rd ed. (Pearson
    2010), section 7.2.2.

    Args:
        inertia: kg m2.
        kd: N m s/rad.
        stiffness: Of the gain and the weight together, N m/rad.
        step_s: Time between samples.
    """
    c = 2 / step_s
    a = np.array(
        [
            inertia * c**2 + kd * c + stiffness,
            2 * stiffness - 2 * inertia * c**2,
            inertia * c**2 - kd * c + stiffness,
        ]
    )
    return np.array([1.0, 2.0, 1.0]) / a[0], a / a[0]


def through(torque: Array, given: Response) -> Array:
    """Angles in rad of torques in N m, shape (T, ...), from rest."""
    return np.asarray(lfilter(*given, torque, axis=0))


def gain_torques(t: Array, command: Array, angle: Array, servo: tuple[float, float]) -> Array:
    """Torques by which kp, kd and latency move the angle, shape (T, 3).

    Args:
        t: Times in s, shape (T,).
        command: Set-points in rad, shape (T,).
        angle: Angles in rad, shape (T,).
        servo: kp in N m/rad and latency in s.
    """
    kp, latency = servo
    seen = np.interp(t - latency, t, command)
    speed = np.gradient(angle, t)
    return np.stack([seen - angle, speed, kp * np.gradient(seen, t)], axis=1)


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
