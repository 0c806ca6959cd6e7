"""A servo linearised about its own motion: from a torque on the shaft to the angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

Response = tuple[Array, Array]
"""Numerator and denominator of a digital filter, as ``scipy.signal.lfilter`` takes them."""


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
