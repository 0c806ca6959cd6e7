"""Observations from measurements of camera and servos, as ``rl.world`` computes in training."""

from __future__ import annotations

from collections import deque

import numpy as np

from rl.deploy.link import Telemetry
from sim2real.arrays import Array, Array32
from sim2real.velocity import NEWEST, newest_velocity, slope_weights

CONTROL_S = 0.02
"""Control period of the policies."""
_KEPT = 64
"""Number of measurements stored."""


class Measurements:
    """The last measurements of one robot; does not need PyTorch."""

    def __init__(self, limit: Array32) -> None:
        """Start without measurements.

        Args:
            limit: Magnitude that each column of an observation is clipped to, shape (O,).
        """
        self._limit = limit
        self._t: deque[float] = deque(maxlen=_KEPT)
        self._rows: deque[Array] = deque(maxlen=_KEPT)

    def take(self, telemetry: Telemetry) -> bool:
        """Store a measurement; False if it is older than the newest, and ignored."""
        if self._t and telemetry.t_s <= self._t[-1]:
            return False
        self._t.append(telemetry.t_s)
        self._rows.append(np.concatenate([telemetry.pose, telemetry.joint]))
        return True

    @property
    def blind_s(self) -> float:
        """Time since the pose and all angles were last measured; infinite if never."""
        measured = np.isfinite(np.array(self._rows))
        t = np.array(self._t)
        if not len(t) or not measured.any(axis=0).all():
            return float("inf")
        return float(t[-1] - min(t[column].max() for column in measured.T))

    def observation(self, target: Array) -> Array32:
        """Surge, sway, yaw rate, angles, their rates, target in the body's frame: shape (O,).

        Velocities are slopes through the last measurements, resampled to a uniform grid; gaps are
        interpolated linearly, or filled with the last value.

        Args:
            target: x and y in the pool's frame in m.

        Raises:
            ValueError: If a column of pose or angles was never measured.
        """
        t, rows = np.array(self._t), np.array(self._rows)
        grid = t[-1] + CONTROL_S * np.arange(1 - NEWEST, 1)
        past = np.empty((NEWEST, rows.shape[1]))
        for k, column in enumerate(rows.T):
            measured = np.isfinite(column)
            if not measured.any():
                raise ValueError(f"column {k} of pose and angles was never measured")
            values = np.unwrap(column[measured]) if k == 2 else column[measured]
            past[:, k] = np.interp(grid, t[measured], values)
        x, y, heading = past[-1, :3]
        c, s = np.cos(heading), np.sin(heading)
        dx, dy = target[0] - x, target[1] - y
        velocity = newest_velocity(past[:, :3], CONTROL_S)
        rate = slope_weights(NEWEST, CONTROL_S) @ past[:, 3:]
        ahead, leftward = c * dx + s * dy, c * dy - s * dx
        columns = np.concatenate([velocity, past[-1, 3:], rate, np.array([ahead, leftward])])
        return np.asarray(np.clip(columns, -self._limit, self._limit), dtype=np.float32)
