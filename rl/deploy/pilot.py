"""Control of one robot to a target: set-points from telemetry, and a record of the swim."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rl.deploy.controller import PolicyController
from rl.deploy.forward import Policy
from rl.deploy.link import SILENCE_S, Telemetry
from rl.deploy.measurements import CONTROL_S, Measurements
from sim2real.arrays import Array

REST_S = 0.5
"""Rest before a swim: a recording starts at rest, and velocities need past measurements."""
_SOON = 0.75
"""Share of the control period before which telemetry is not answered again."""


@dataclass(frozen=True)
class Track:
    """Record of a swim, one row for each set-point message.

    Attributes:
        t: Arrival of the telemetry on this computer in s, from the first, shape (T,).
        device_t: The robot's clock, shape (T,).
        command: Set-points sent in answer, shape (T, J).
        joint: Measured angles, shape (T, J), NaN if missing.
        pose: x, y, heading, shape (T, 3), NaN if missing.
        reached_s: Time at which the target was reached, from the end of rest; None if it was not.
        closest_m: Smallest distance to the target; infinite if the swim never started.
        stopped: Reason of an early end; None at the target or when the time was up.
    """

    t: Array
    device_t: Array
    command: Array
    joint: Array
    pose: Array
    reached_s: float | None
    closest_m: float
    stopped: str | None


@dataclass
class Pilot:
    """Answers telemetry until the robot is at the target or the time is up.

    Attributes:
        policy: Policy of the robot.
        target: x and y in the pool's frame in m.
        seconds: Longest swim, after rest.
        arrive_m: Distance at which the target is reached.
        stopped: Reason of an early end, or None.
    """

    policy: Policy
    target: Array
    seconds: float
    arrive_m: float = 0.05
    stopped: str | None = None
    _reached_s: float | None = None
    _closest_m: float = float("inf")
    _rows: list[tuple[float, Array, Telemetry]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._measurements = Measurements(self.policy.observation_limit)
        self._controller = PolicyController(self.policy)
        self._period: int | None = None
        self.rest: Array = np.clip(0.0, self.policy.low, self.policy.high).astype(np.float64)

    @property
    def elapsed_s(self) -> float:
        """Seconds since the end of rest, by the robot's clock; negative before."""
        return self._rows[-1][2].t_s - self._rows[0][2].t_s - REST_S if self._rows else -REST_S

    @property
    def over(self) -> bool:
        """Whether the swim has ended."""
        late = self.elapsed_s > self.seconds - CONTROL_S / 2
        return self.stopped is not None or self._reached_s is not None or late

    def answer(self, news: list[Telemetry], arrived_s: float) -> Array | None:
        """Set-points for the newest telemetry, shape (J,); None if there is nothing new."""
        fresh = [telemetry for telemetry in news if self._measurements.take(telemetry)]
        if not fresh:
            return None
        newest = fresh[-1]
        if self._rows and newest.t_s - self._rows[-1][2].t_s < _SOON * CONTROL_S:
            return None
        self._rows.append((arrived_s, self.rest, newest))
        if self.elapsed_s < -CONTROL_S / 2:
            return self.rest
        if self._measurements.blind_s > SILENCE_S:
            self.stopped = f"no pose or joint angles for {SILENCE_S:g} s"
            return self.rest
        command = self._command()
        self._rows[-1] = (arrived_s, command, newest)
        return command

    def _command(self) -> Array:
        observation = self._measurements.observation(self.target)
        distance = float(np.hypot(*observation[-2:]))
        self._closest_m = min(self._closest_m, distance)
        if distance < self.arrive_m:
            self._reached_s = max(self.elapsed_s, 0.0)
        if self.over:
            return self.rest
        period = round(self.elapsed_s / CONTROL_S)
        gone = 1 if self._period is None else period - self._period
        self._period = period
        return np.asarray(self._controller.act(observation[None], gone)[0], dtype=np.float64)

    def track(self) -> Track:
        """Record of the swim so far."""
        J = len(self.rest)
        arrived = np.array([t for t, _, _ in self._rows])
        return Track(
            t=arrived - arrived[:1].sum(),
            device_t=np.array([telemetry.t_s for _, _, telemetry in self._rows]),
            command=np.array([sent for _, sent, _ in self._rows]).reshape(-1, J),
            joint=np.array([telemetry.joint for _, _, telemetry in self._rows]).reshape(-1, J),
            pose=np.array([telemetry.pose for _, _, telemetry in self._rows]).reshape(-1, 3),
            reached_s=self._reached_s,
            closest_m=self._closest_m,
            stopped=self.stopped,
        )
