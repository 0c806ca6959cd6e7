"""The line of sight to the target, from an observation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_COMMIT_RAD = 1.25 * np.pi
"""A turn goes on the same way up to this bearing, though the other way be shorter by then."""
_NEAR_M = 0.05
"""Distance below which the target is reached; the line of sight turns no faster than there."""


def bearing(observation: NDArray[np.floating]) -> Array:
    """Angle from the heading to the target in rad, left positive, shape (E,)."""
    seen = np.asarray(observation, dtype=np.float64)
    return np.asarray(np.arctan2(seen[:, -1], seen[:, -2]))


def line_of_sight_rate(observation: NDArray[np.floating]) -> Array:
    """How fast the line to a target at rest turns in the world, in rad/s, shape (E,).

    With the target at r in the body's frame and the robot's velocity v, it is
    ``-(r x v) / |r|^2``: no signal needs to be differentiated.
    """
    seen = np.asarray(observation, dtype=np.float64)
    surge, sway, x, y = seen[:, 0], seen[:, 1], seen[:, -2], seen[:, -1]
    return np.asarray((y * surge - x * sway) / np.maximum(x * x + y * y, _NEAR_M**2))


class LineOfSight:
    """Bearing and rate of the line of sight, without jumps, smoothed over the tail's beat.

    Attributes:
        bearing: Angle to the target in rad, shape (E,), within 225 degrees either side.
        smooth: The same through a low-pass filter of first order.
        rate: Turning of the line in rad/s through the same filter.
    """

    def __init__(self, n_envs: int, filter_s: ArrayLike, *, dt: float) -> None:
        """``filter_s`` is the filter's time constant in s, a number or one for each robot."""
        self._share = -np.expm1(-dt / np.maximum(np.asarray(filter_s, dtype=np.float64), 1e-9))
        self._fresh = np.ones(n_envs, dtype=bool)
        self.bearing, self.smooth, self.rate = (np.zeros(n_envs) for _ in range(3))

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Robots in ``mask`` (E,) begin anew."""
        self._fresh |= mask

    def update(self, observation: NDArray[np.floating]) -> None:
        """Take in one control period."""
        seen, rate = bearing(observation), line_of_sight_rate(observation)
        near = self.bearing + wrap(seen - self.bearing)
        now = np.where(self._fresh | (np.abs(near) > _COMMIT_RAD), seen, near)
        whole = 2 * np.pi * np.round((now - near) / (2 * np.pi))  # the other way round, from now on
        self.smooth = np.where(self._fresh, now, self.smooth + whole)
        self.rate = np.where(self._fresh, rate, self.rate)
        self.smooth += self._share * (now - self.smooth)
        self.rate += self._share * (rate - self.rate)
        self.bearing = now
        self._fresh[:] = False


def wrap(angle: Array) -> Array:
    """Angles brought into [-pi, pi)."""
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi)
