"""The one observer between the task's 50 Hz and a policy: what it sees, when it decides, how.

Training, evaluation, exported policies and robots all go through it, in PyTorch or NumPy by the
same lines; the C header of ``rl.deploy.header`` is tested equal to it. A policy's file says by
which ``View`` it was trained. Letters: E robots, J joints, O columns of the task, F of the policy.

Why it is as it is: at 20 ms a decision hardly changes what follows, so that its advantage drowns
(Tallec, Blier, Ollivier, "Making deep Q-learning methods robust to time discretization", ICML
2019), and the latency spans several; the state of a delayed process is the observation and the
actions under way (Katsikopoulos, Engelbrecht, IEEE Trans. Autom. Control 48 (2003) 568). A robot
with like sides whose target is right behind has no side to turn to, and one at rest none to beat to
first; two columns that are odd in the mirror break these ties.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

TASK_S = 0.02
"""Control period of set-points and measurements."""
KEPT_RAD = 1.25 * np.pi
"""The bearing keeps its side until the target has gone so far round."""
STROKE = 0.15
"""Mean set-point, as a share of the joints' range, from which a stroke has a side."""
SURGE_M_S, SWAY_M_S, YAW_RAD_S, RATE_RAD_S = 0.4, 0.2, 2.0, 4.0
NEAR_M, HALF_M = 0.05, 0.5
"""The distance's column is log((d + near) / half)."""
LARGEST = 10.0
"""Scaled columns are cut to this size."""


@dataclass(frozen=True)
class View:
    """How a policy looks at the task; the defaults are this library's, ``PAPER`` the paper's.

    Attributes:
        period: Control periods of 20 ms between decisions.
        ramp: Set-points go on a line from decision to decision, else at once.
        memory: Last decisions that are seen.
        scaled: Columns of order one, the target by sine, cosine and logarithm of its distance.
        sides: The kept bearing and the side of the last stroke are seen.
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
        """1 for each column that changes its sign in the mirror, else 0, shape (F,)."""
        target = [1.0, 0.0, 0.0] if self.scaled else [0.0, 1.0]
        sides = [1.0, 1.0] if self.sides else []
        return [0.0, 1.0, 1.0, *[1.0] * (2 * J), *target, *sides, *[1.0] * (self.memory * J)]

    @property
    def decision_s(self) -> float:
        """Seconds between decisions."""
        return TASK_S * self.period


PAPER = View(period=1, ramp=False, memory=0, scaled=False, sides=False)
"""The paper's own: eleven columns in SI units, a set-point every 20 ms."""


class Observer:
    """What E robots remember: decisions, the side of the target and of the last stroke.

    Attributes:
        view: How it looks.
    """

    def __init__(self, view: View, low: Any, high: Any, n: int) -> None:  # noqa: ANN401
        """Begin with no memory.

        Args:
            view: How to look.
            low: Joint angles that -1 stands for, shape (J,), a tensor or an array of float32; all
                else is of the same library.
            high: Those that 1 stands for.
            n: Number of robots.
        """
        self.view, self._low, self._span = view, low, high - low
        shape = (n, max(view.memory, 2), low.shape[0])
        if isinstance(low, np.ndarray):
            self._xp: Any = np
            self._given = np.zeros(shape, low.dtype)  # newest first
        else:
            import torch

            self._xp = torch
            self._given = low.new_zeros(shape)
        self._bearing = self._given[:, 0, 0]
        self._side = self._bearing + 1

    def begin(self, seen: Any, rows: Any = None) -> None:  # noqa: ANN401 - of either library
        """Forget, where ``rows`` (E,) says so; the task's columns (E, O) say where robots are."""
        xp, J = self._xp, self._low.shape[0]
        share = xp.clip(2 * (seen[:, 3 : 3 + J] - self._low) / self._span - 1, -1.0, 1.0)
        given = xp.stack([share] * self._given.shape[1], 1)
        bearing = xp.arctan2(seen[:, -1], seen[:, -2])
        side = xp.where(bearing < 0, self._side * 0 - 1, self._side * 0 + 1)
        if rows is None:
            rows = bearing == bearing
        self._given = xp.where(rows[:, None, None], given, self._given)
        self._bearing = xp.where(rows, bearing, self._bearing)
        self._side = xp.where(rows, side, self._side)

    def see(self, seen: Any, rows: Any = None) -> Any:  # noqa: ANN401
        """The policy's columns (E, F) from the task's (E, O); call it where a decision is due."""
        xp, J, view = self._xp, self._low.shape[0], self.view
        ahead, left = seen[:, -2], seen[:, -1]
        bearing = self._kept(xp.arctan2(left, ahead))
        self._bearing = bearing if rows is None else xp.where(rows, bearing, self._bearing)
        parts = [seen]
        if view.scaled:
            distance = xp.sqrt(ahead**2 + left**2)
            angle = 2 * (seen[:, 3 : 3 + J] - self._low) / self._span - 1
            columns = [
                seen[:, 0] / SURGE_M_S, seen[:, 1] / SWAY_M_S, seen[:, 2] / YAW_RAD_S,
                *(angle[:, k] for k in range(J)),
                *(seen[:, 3 + J + k] / RATE_RAD_S for k in range(J)),
                xp.sin(bearing), xp.cos(bearing), xp.log((distance + NEAR_M) / HALF_M),
            ]  # fmt: skip
            parts = [xp.clip(xp.stack(columns, 1), -LARGEST, LARGEST)]
        if view.sides:
            parts.append(xp.stack([bearing / np.pi, self._side], 1))
        if view.memory:
            parts.append(self._given[:, : view.memory].reshape(len(seen), -1))
        return xp.concatenate(parts, 1)

    def _kept(self, bearing: Any) -> Any:  # noqa: ANN401
        """The bearing, beyond half a turn where it has come there from the other side."""
        xp, turn = self._xp, 2 * np.pi
        other = xp.where(bearing > 0, bearing - turn, bearing + turn)
        crossed = (bearing * self._bearing < 0) & (abs(other) <= KEPT_RAD)
        return xp.where(crossed, other, bearing)

    def decide(self, action: Any, rows: Any = None) -> None:  # noqa: ANN401
        """Take decisions between -1 and 1, shape (E, J), where ``rows`` (E,) says so."""
        xp = self._xp
        mean = action.mean(1)
        side = xp.where(abs(mean) > STROKE, xp.sign(mean), self._side)
        given = xp.concatenate([action[:, None], self._given[:, :-1]], 1)
        if rows is not None:
            side = xp.where(rows, side, self._side)
            given = xp.where(rows[:, None, None], given, self._given)
        self._side, self._given = side, given

    def set_points(self, tick: Any) -> Any:  # noqa: ANN401
        """Joint angles in rad, shape (E, J).

        Args:
            tick: Control periods since the decision, from 0, one number or shape (E, 1).
        """
        now, before = self._given[:, 0], self._given[:, 1]
        if self.view.ramp:
            now = before + (now - before) * ((tick + 1) / self.view.period)
        return self._low + (now + 1) / 2 * self._span
