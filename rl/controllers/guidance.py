"""The line of sight to the target, from an observation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim2real.arrays import Array, Mask

_COMMIT_RAD = 1.25 * np.pi
"""Bearing up to which a turn keeps its direction, even if the other is shorter: hysteresis."""
_NEAR_M = 0.05
"""Distance at which the target is reached; smallest distance in the line-of-sight rate."""


def bearing(observation: NDArray[np.floating]) -> Array:
    """Angle from the heading to the target in rad, left positive, shape (E,)."""
    columns = np.asarray(observation, dtype=np.float64)
    return np.asarray(np.arctan2(columns[:, -1], columns[:, -2]))


def line_of_sight_rate(observation: NDArray[np.floating]) -> Array:
    """Angular rate of the line to a target at rest, in the pool's frame, in rad/s, shape (E,).

    With the target at r in the body's frame and the robot's velocity v, it is
    ``-(r x v) / |r|^2``, without differentiation of a signal.
    """
    columns = np.asarray(observation, dtype=np.float64)
    surge, sway, x, y = columns[:, 0], columns[:, 1], columns[:, -2], columns[:, -1]
    return np.asarray((y * surge - x * sway) / np.maximum(x * x + y * y, _NEAR_M**2))


class LineOfSight:
    """Bearing and rate of the line of sight, unwrapped, smoothed over the tail's beat.

    Attributes:
        bearing: Angle to the target in rad, shape (E,), within 225 degrees to either side.
        smooth: The bearing after a first-order low-pass filter.
        rate: Angular rate of the line in rad/s after the same filter.
    """

    def __init__(self, n_envs: int, filter_s: ArrayLike, *, dt: float) -> None:
        """``filter_s`` is the time constant of the filter in s, a number or an array (E,)."""
        self._share = -np.expm1(-dt / np.maximum(np.asarray(filter_s, dtype=np.float64), 1e-9))
        self._fresh = np.ones(n_envs, dtype=bool)
        self.bearing, self.smooth, self.rate = (np.zeros(n_envs) for _ in range(3))

    def reset(self, mask: Mask) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask

    def update(self, observation: NDArray[np.floating]) -> None:
        """Update with the observation of a control period."""
        measured, rate = bearing(observation), line_of_sight_rate(observation)
        continued = self.bearing + wrap(measured - self.bearing)
        current = np.where(self._fresh | (np.abs(continued) > _COMMIT_RAD), measured, continued)
        turns = (
            2 * np.pi * np.round((current - continued) / (2 * np.pi))
        )  # turns if the direction changes
        self.smooth = np.where(self._fresh, current, self.smooth + turns)
        self.rate = np.where(self._fresh, rate, self.rate)
        self.smooth += self._share * (current - self.smooth)
        self.rate += self._share * (rate - self.rate)
        self.bearing = current
        self._fresh[:] = False


def wrap(angle: Array) -> Array:
    """Angles wrapped to [-pi, pi)."""
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi)
