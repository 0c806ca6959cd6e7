"""Likelihood of recorded angles, given what they would be without noise.

The noise is white (sensor and rounding) plus an Ornstein-Uhlenbeck process. Its covariance is
whitened exactly by the scalar Kalman filter: Särkkä & Solin, "Applied Stochastic Differential
Equations" (2019), chapter 10.
"""

from __future__ import annotations

import numpy as np
from bench import Sensor
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


def whiten(residual: Array, t: Array, sensor: Sensor, step_rad: float) -> tuple[Array, float]:
    """Residuals in units of their own noise, and the log-likelihood.

    Args:
        residual: Recorded less expected, rad, shape (T,); NaN where a sample is missing.
        t: Times in s, shape (T,).
        sensor: The joint's noise.
        step_rad: Step to which the angle was rounded.

    Returns:
        Independent standard normals if the expectation is right, shape (T,), 0 where missing; and
        the log-likelihood.
    """
    white = sensor.white_rad**2 + step_rad**2 / 12
    return _filter(residual, t, white, sensor.wander_rad**2, sensor.wander_s)


@njit
def _filter(residual, t, white, wander, wander_s):
    whitened, loglik = np.zeros(t.size), 0.0
    mean, variance = 0.0, wander
    for k in range(t.size):
        if k > 0:
            keep = np.exp(-(t[k] - t[k - 1]) / wander_s)
            mean *= keep
            variance = wander + keep**2 * (variance - wander)
        if np.isnan(residual[k]):
            continue
        total = variance + white
        innovation = residual[k] - mean
        whitened[k] = innovation / np.sqrt(total)
        loglik -= 0.5 * (whitened[k] ** 2 + np.log(2 * np.pi * total))
        mean += variance / total * innovation
        variance *= white / total
    return whitened, loglik
