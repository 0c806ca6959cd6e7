"""Interface of a policy to the task at 50 Hz: observations, decision times and set-points.

Training, evaluation, exported policies and robots all use it, in PyTorch or NumPy with the same
code; the C header of ``rl.deploy.header`` is tested to be equivalent. A policy file states the
``View`` of its training. Letters: E robots, J joints, O columns of the task, F of the policy.

Reasons for the design: at 20 ms a decision hardly changes the return, so that its advantage is lost
in noise (Tallec, Blier, Ollivier, "Making deep Q-learning methods robust to time discretization",
ICML 2019), and the latency spans several decisions; the state of a delayed process consists of the
observation and the pending actions (Katsikopoulos, Engelbrecht, IEEE Trans. Autom. Control 48
(2003) 568). For a symmetric robot, the direction of a turn to a target directly behind, and of the
first stroke from rest, are ambiguous; two columns that are odd under mirroring resolve this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

TASK_S = 0.02
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
MOST = 1000
"""Largest period and memory of a view."""


@dataclass(frozen=True)
class View:
    """Definition of a policy's observations and decisions; ``PAPER`` is that of the paper.

    Attributes:
        period: Control periods of 20 ms between decisions.
        ramp: Whether set-points are interpolated linearly between decisions, else steps.
        memory: Number of past decisions in the observation.
        scaled: Whether columns are scaled to order one, with sine and cosine of the bearing and
            logarithm of the distance.
        sides: Whether the bearing with hysteresis and the side of the last stroke are observed.
    """

    period: int = 4
    ramp: bool = True
    memory: int = 2
    scaled: bool = True
    sides: bool = True

    def columns(self, joints: Sequence[str]) -> list[str]:
        """Names of the policy's F columns, in order."""
        body = ["surge", "sway", "yaw_rate"] if self.scaled else ["surge_m_s", "sway_m_s"]
        unit = ("", "") if self.scaled else (".position_rad", ".velocity_rad_s")
        if not self.scaled:
            body.append("yaw_rate_rad_s")
            target = ["target_ahead_m", "target_left_m"]
        else:
            unit = (".position", ".velocity")
            target = ["bearing_sine", "bearing_cosine", "log_distance"]
        names = [*body, *(f"{j}{unit[0]}" for j in joints), *(f"{j}{unit[1]}" for j in joints)]
        names += target + (["kept_bearing", "stroke_side"] if self.sides else [])
        return names + [f"{j}.decision_{k + 1}_ago" for k in range(self.memory) for j in joints]

    def size(self, J: int) -> int:
        """Number of the policy's columns F."""
        return 3 + 2 * J + (3 if self.scaled else 2) + (2 if self.sides else 0) + self.memory * J

    def odd(self, J: int) -> list[float]:
        """1 for each column that changes its sign under mirroring, else 0, shape (F,)."""
        target = [1.0, 0.0, 0.0] if self.scaled else [0.0, 1.0]
        sides = [1.0, 1.0] if self.sides else []
        return [0.0, 1.0, 1.0, *[1.0] * (2 * J), *target, *sides, *[1.0] * (self.memory * J)]

    @classmethod
    def from_content(cls, fields: Any) -> View:  # noqa: ANN401 - any JSON
        """The view with the fields of a file.

        Raises:
            ValueError: If a field is missing, unknown, of another type or out of range.
        """
        kinds = {"period": int, "ramp": bool, "memory": int, "scaled": bool, "sides": bool}
        if not isinstance(fields, dict) or {k: type(v) for k, v in fields.items()} != kinds:
            raise ValueError(f"a view {fields!r}")
        if not 1 <= fields["period"] <= MOST or not 0 <= fields["memory"] <= MOST:
            raise ValueError(f"a view {fields!r}")
        return cls(**fields)

    @property
    def decision_s(self) -> float:
        """Seconds between decisions."""
        return TASK_S * self.period


PAPER = View(period=1, ramp=False, memory=0, scaled=False, sides=False)
"""View of the paper: eleven columns in SI units, a set-point every 20 ms."""


class Observer:
    """State of E observers: past decisions, the sides of the target and of the last stroke.

    Attributes:
        view: Definition of the observations.
    """

    def __init__(self, view: View, low: Any, high: Any, n: int) -> None:  # noqa: ANN401
        """Start without past decisions.

        Args:
            view: Definition of the observations.
            low: Joint angles of action -1, shape (J,), a tensor or an array of float32; all other
                arguments are of the same library.
            high: Joint angles of action 1.
            n: Number of robots.
        """
        self.view, self._low, self._span = view, low, high - low
        shape = (n, max(view.memory, 2), low.shape[0])
        if isinstance(low, np.ndarray):
            self._xp: Any = np
            self._decisions = np.zeros(shape, low.dtype)  # newest first
        else:
            import torch

            self._xp = torch
            self._decisions = low.new_zeros(shape)
        self._bearing = self._decisions[:, 0, 0]
        self._side = self._bearing + 1

    def begin(self, raw: Any, rows: Any = None) -> None:  # noqa: ANN401 - of either library
        """Reset where ``rows`` (E,) is true, given the observation of the task (E, O)."""
        xp, J = self._xp, self._low.shape[0]
        share = xp.clip(2 * (raw[:, 3 : 3 + J] - self._low) / self._span - 1, -1.0, 1.0)
        decisions = xp.stack([share] * self._decisions.shape[1], 1)
        bearing = xp.arctan2(raw[:, -1], raw[:, -2])
        side = xp.where(bearing < 0, self._side * 0 - 1, self._side * 0 + 1)
        if rows is None:
            rows = bearing == bearing
        self._decisions = xp.where(rows[:, None, None], decisions, self._decisions)
        self._bearing = xp.where(rows, bearing, self._bearing)
        self._side = xp.where(rows, side, self._side)

    def observe(self, raw: Any, rows: Any = None) -> Any:  # noqa: ANN401
        """The policy's columns (E, F) from the task's (E, O); to be called before each decision."""
        xp, J, view = self._xp, self._low.shape[0], self.view
        ahead, leftward = raw[:, -2], raw[:, -1]
        bearing = self._with_hysteresis(xp.arctan2(leftward, ahead))
        self._bearing = bearing if rows is None else xp.where(rows, bearing, self._bearing)
        parts = [raw]
        if view.scaled:
            distance = xp.sqrt(ahead**2 + leftward**2)
            angle = 2 * (raw[:, 3 : 3 + J] - self._low) / self._span - 1
            columns = [
                raw[:, 0] / SURGE_M_S, raw[:, 1] / SWAY_M_S, raw[:, 2] / YAW_RAD_S,
                *(angle[:, k] for k in range(J)),
                *(raw[:, 3 + J + k] / RATE_RAD_S for k in range(J)),
                xp.sin(bearing), xp.cos(bearing), xp.log((distance + NEAR_M) / HALF_M),
            ]  # fmt: skip
            parts = [xp.clip(xp.stack(columns, 1), -LARGEST, LARGEST)]
        if view.sides:
            parts.append(xp.stack([bearing / np.pi, self._side], 1))
        if view.memory:
            parts.append(self._decisions[:, : view.memory].reshape(len(raw), -1))
        return xp.concatenate(parts, 1)

    def _with_hysteresis(self, bearing: Any) -> Any:  # noqa: ANN401
        """The bearing, beyond pi if the target crossed the axis behind the robot."""
        xp, turn = self._xp, 2 * np.pi
        wrapped = xp.where(bearing > 0, bearing - turn, bearing + turn)
        crossed = (bearing * self._bearing < 0) & (abs(wrapped) <= KEPT_RAD)
        return xp.where(crossed, wrapped, bearing)

    def decide(self, action: Any, rows: Any = None) -> None:  # noqa: ANN401
        """Store decisions between -1 and 1, shape (E, J), where ``rows`` (E,) is true."""
        xp = self._xp
        mean = action.mean(1)
        side = xp.where(abs(mean) > STROKE, xp.sign(mean), self._side)
        decisions = xp.concatenate([action[:, None], self._decisions[:, :-1]], 1)
        if rows is not None:
            side = xp.where(rows, side, self._side)
            decisions = xp.where(rows[:, None, None], decisions, self._decisions)
        self._side, self._decisions = side, decisions

    def set_points(self, tick: Any) -> Any:  # noqa: ANN401
        """Joint angles in rad, shape (E, J).

        Args:
            tick: Control periods since the decision, from 0, one number or shape (E, 1).
        """
        current, before = self._decisions[:, 0], self._decisions[:, 1]
        if self.view.ramp:
            current = before + (current - before) * ((tick + 1) / self.view.period)
        return self._low + (current + 1) / 2 * self._span
