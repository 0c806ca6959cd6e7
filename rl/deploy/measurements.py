"""What a policy sees, from what cameras and servos measured: as ``rl.world`` in training."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from rl.deploy.link import Telemetry
from sim2real.velocity import NEWEST, newest_velocity, slope_weights

Array = NDArray[np.float64]

CONTROL_S = 0.02
"""Control period of the policies."""
_KEPT = 64
"""Measurements remembered."""


class Measurements:
    """The last measurements of one robot; needs no PyTorch."""

    def __init__(self, limit: NDArray[np.float32]) -> None:
        """Begin with no measurement.

        Args:
            limit: Largest size of each column of an observation, shape (O,); beyond it is cut.
        """
        self._limit = limit
        self._t: deque[float] = deque(maxlen=_KEPT)
        self._rows: deque[Array] = deque(maxlen=_KEPT)

    def take(self, seen: Telemetry) -> bool:
        """Remember a measurement; False if it is older than the newest, and passed over."""
        if self._t and seen.t_s <= self._t[-1]:
            return False
        self._t.append(seen.t_s)
        self._rows.append(np.concatenate([seen.pose, seen.joint]))
        return True

    @property
    def blind_s(self) -> float:
        """Time since all of pose and angles were last known, infinite if they never were."""
        known = np.isfinite(np.array(self._rows))
        t = np.array(self._t)
        if not len(t) or not known.any(axis=0).all():
            return float("inf")
        return float(t[-1] - min(t[column].max() for column in known.T))

    def observation(self, target: Array) -> NDArray[np.float32]:
        """Surge, sway, yaw rate, angles, their rates, target in the body's frame: shape (O,).

        Velocities are slopes through the last measurements, brought to an even grid first; what
        was not seen is bridged by a line, or held.

        Args:
            target: x and y in the pool's frame in m.

        Raises:
            ValueError: If some of pose or angles was never seen.
        """
        t, rows = np.array(self._t), np.array(self._rows)
        grid = t[-1] + CONTROL_S * np.arange(1 - NEWEST, 1)
        past = np.empty((NEWEST, rows.shape[1]))
        for k, column in enumerate(rows.T):
            known = np.isfinite(column)
            if not known.any():
                raise ValueError(f"column {k} of pose and angles was never seen")
            values = np.unwrap(column[known]) if k == 2 else column[known]
            past[:, k] = np.interp(grid, t[known], values)
        x, y, heading = past[-1, :3]
        c, s = np.cos(heading), np.sin(heading)
        dx, dy = target[0] - x, target[1] - y
        velocity = newest_velocity(past[:, :3], CONTROL_S)
        rate = slope_weights(NEWEST, CONTROL_S) @ past[:, 3:]
        ahead, left = c * dx + s * dy, c * dy - s * dx
        seen = np.concatenate([velocity, past[-1, 3:], rate, np.array([ahead, left])])
        return np.asarray(np.clip(seen, -self._limit, self._limit), dtype=np.float32)
