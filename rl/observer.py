"""Interface of a policy to the task at 50 Hz: observations, decision times and set-points.

Training, evaluation, exported policies and robots all use it, in PyTorch or NumPy. A policy file
states the ``View`` of its training. Letters: E robots, J joints, O columns of the task, F of the
policy. Decisions every 20 ms would hardly change the return (Tallec, Blier, Ollivier, ICML 2019);
the state of a delayed process has pending actions (Katsikopoulos, Engelbrecht, IEEE Trans. Autom.
Control 48 (2003) 568).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

CONTROL_S = 0.02
"""Control period of set-points and measurements."""
KEPT_RAD = 1.25 * np.pi
"""Largest magnitude of the bearing before it changes sign, beyond pi: a hysteresis."""
STROKE = 0.15
"""Smallest mean set-point, as a share of the joints' range, that defines the side of a stroke."""
SURGE_M_S, SWAY_M_S, YAW_RAD_S, RATE_RAD_S = 0.4, 0.2, 2.0, 4.0
NEAR_M, HALF_M = 0.05, 0.5
"""The column of the distance d is log((d + near) / half)."""
LARGEST = 10.0
"""Scaled columns are clipped to this magnitude."""


def observation_names(joints: Sequence[str]) -> list[str]:
    """Names of the task's columns, in order, with units."""
    angles = [f"{joint}.position_rad" for joint in joints]
    rates = [f"{joint}.velocity_rad_s" for joint in joints]
    body = ["surge_m_s", "sway_m_s", "yaw_rate_rad_s"]
    return [*body, *angles, *rates, "target_ahead_m", "target_left_m"]


def observation_bounds(J: int) -> list[float]:
    """Bounds of the magnitude of each of the task's columns, which are clipped to them."""
    return [10.0, 10.0, 50.0, *[4.0] * J, *[100.0] * J, 20.0, 20.0]


def observed(past: Any, weights: Any, target: Any, limit: Any) -> Any:  # noqa: ANN401
    """The task's columns (E, O), the paper's observation; all arrays are of one library.

    From the last x, y, heading, continuous, and joint angles, oldest first, (E, n, 3 + J), whose
    slopes by ``slope_weights`` (n,) are the velocities, and x and y of the target, (E, 2). Columns
    are clipped to the magnitudes ``limit``, (O,).
    """
    xp, latest, slope = _library(past), past[:, -1], (past * weights[:, None]).sum(1)
    c, s = xp.cos(latest[:, 2]), xp.sin(latest[:, 2])
    x, y = xp.stack([slope[:, :2], target - latest[:, :2]], 2).swapaxes(0, 1)  # (E, 2) each
    ahead, left = c[:, None] * x + s[:, None] * y, c[:, None] * y - s[:, None] * x
    motion = [ahead[:, :1], left[:, :1], slope[:, 2:3], latest[:, 3:], slope[:, 3:]]
    return xp.clip(xp.concatenate([*motion, ahead[:, 1:], left[:, 1:]], 1), -limit, limit)


def _library(array: Any) -> Any:  # noqa: ANN401 - a module
    """NumPy or PyTorch."""
    if isinstance(array, np.ndarray):
        return np
    import torch

    return torch


@dataclass(frozen=True)
class View:
    """Definition of a policy's observations and decisions; ``PAPER`` is that of the paper."""

    period: int = 4  # control periods of 20 ms between decisions
    ramp: bool = True  # set-points are interpolated linearly between decisions, else steps
    memory: int = 2  # number of past decisions in the observation, newest first
    # columns are surge, sway, yaw rate, joint angles and rates, sine and cosine of the bearing and
    # log distance, of order one, else those of the task
    scaled: bool = True
    # the bearing with hysteresis and the side of the last stroke are observed, which say where a
    # symmetric robot turns from a target directly behind
    sides: bool = True

    def size(self, J: int) -> int:
        """Number of the policy's columns F."""
        return len(self.odd(J))

    def odd(self, J: int) -> list[float]:
        """1 for each column that changes its sign under mirroring, else 0, shape (F,)."""
        target = [1.0, 0.0, 0.0] if self.scaled else [0.0, 1.0]
        sides = [1.0, 1.0] if self.sides else []
        return [0.0, 1.0, 1.0, *[1.0] * (2 * J), *target, *sides, *[1.0] * (self.memory * J)]

    @classmethod
    def from_content(cls, fields: Any) -> View:  # noqa: ANN401 - any JSON
        """The view with the fields of a file, or a ValueError about one."""
        kinds = {name: type(default) for name, default in vars(cls()).items()}
        fits = isinstance(fields, dict) and {k: type(v) for k, v in fields.items()} == kinds
        if not fits or not 1 <= fields["period"] <= 1000 or not 0 <= fields["memory"] <= 1000:
            raise ValueError(f"a view {fields!r}")
        return cls(**fields)

    @property
    def decision_s(self) -> float:
        """Seconds between decisions."""
        return CONTROL_S * self.period


PAPER = View(period=1, ramp=False, memory=0, scaled=False, sides=False)
"""View of the paper: eleven columns in SI units, a set-point every 20 ms."""


class Observer:
    """State of E observers: past decisions, the sides of the target and of the last stroke."""

    def __init__(self, view: View, low: Any, high: Any, n: int) -> None:  # noqa: ANN401
        """Start n robots; ``low`` and ``high`` (J,) are the angles of actions -1 and 1."""
        self.view, self._low, self._span, self._xp = view, low, high - low, _library(low)
        shape = (n, max(view.memory, 2), len(low))
        self._decisions = self._xp.broadcast_to(self._xp.zeros_like(low), shape)  # newest first
        self._bearing = self._decisions[:, 0, 0]
        self._side = self._bearing + 1

    def memory(self) -> Any:  # noqa: ANN401 - of either library
        """The state as one array, shape (E, K J + 2)."""
        _, K, J = self._decisions.shape
        parts = [self._decisions.reshape(-1, K * J), self._bearing[:, None], self._side[:, None]]
        return self._xp.concatenate(parts, 1)

    def remember(self, memory: Any) -> None:  # noqa: ANN401
        """Set the state that ``memory`` returned."""
        _, K, J = self._decisions.shape
        self._decisions = memory[:, :-2].reshape(-1, K, J)
        self._bearing, self._side = memory[:, -2], memory[:, -1]

    def begin(self, raw: Any, rows: Any = None) -> None:  # noqa: ANN401
        """Reset where ``rows`` (E,) is true, given the observation of the task (E, O)."""
        xp = self._xp
        decisions = xp.stack([xp.clip(self._shares(raw), -1.0, 1.0)] * self._decisions.shape[1], 1)
        bearing = xp.arctan2(raw[:, -1], raw[:, -2])
        side = xp.where(bearing < 0, self._side * 0 - 1, self._side * 0 + 1)
        if rows is None:
            rows = bearing == bearing
        self._decisions = xp.where(rows[:, None, None], decisions, self._decisions)
        self._bearing = xp.where(rows, bearing, self._bearing)
        self._side = xp.where(rows, side, self._side)

    def _shares(self, raw: Any) -> Any:  # noqa: ANN401
        """Joint angles (E, J), -1 and 1 at the ends of each joint's range."""
        return 2 * (raw[:, 3 : 3 + len(self._low)] - self._low) / self._span - 1

    def observe(self, raw: Any) -> Any:  # noqa: ANN401
        """The policy's columns (E, F) from the task's (E, O); to be called before each decision."""
        xp, J, view = self._xp, len(self._low), self.view
        ahead, leftward = raw[:, -2], raw[:, -1]
        if view.scaled or view.sides:
            bearing, turn = xp.arctan2(leftward, ahead), 2 * np.pi
            # beyond pi if the target crossed the axis behind the robot: a hysteresis
            wrapped = xp.where(bearing > 0, bearing - turn, bearing + turn)
            crossed = (bearing * self._bearing < 0) & (abs(wrapped) <= KEPT_RAD)
            self._bearing = bearing = xp.where(crossed, wrapped, bearing)
        parts = [raw]
        if view.scaled:
            distance = xp.sqrt(ahead**2 + leftward**2)
            columns = [
                raw[:, 0] / SURGE_M_S, raw[:, 1] / SWAY_M_S, raw[:, 2] / YAW_RAD_S,
                *self._shares(raw).T, *(raw[:, 3 + J : 3 + 2 * J] / RATE_RAD_S).T,
                xp.sin(bearing), xp.cos(bearing), xp.log((distance + NEAR_M) / HALF_M),
            ]  # fmt: skip
            parts = [xp.clip(xp.stack(columns, 1), -LARGEST, LARGEST)]
        if view.sides:
            parts.append(xp.stack([bearing / np.pi, self._side], 1))
        if view.memory:
            parts.append(self._decisions[:, : view.memory].reshape(-1, view.memory * J))
        return xp.concatenate(parts, 1)

    def decide(self, action: Any) -> None:  # noqa: ANN401
        """Store decisions between -1 and 1, shape (E, J)."""
        xp = self._xp
        if self.view.sides:
            mean = action.mean(1)
            self._side = xp.where(abs(mean) > STROKE, xp.sign(mean), self._side)
        self._decisions = xp.concatenate([action[:, None], self._decisions[:, :-1]], 1)

    def set_points(self, tick: int) -> Any:  # noqa: ANN401
        """Joint angles in rad, shape (E, J), ``tick`` control periods after the decision."""
        current, before = self._decisions[:, 0], self._decisions[:, 1]
        if self.view.ramp:
            current = before + (current - before) * ((tick + 1) / self.view.period)
        return self._low + (current + 1) / 2 * self._span
