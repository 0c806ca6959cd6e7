"""Who steers one robot to a target: from telemetry to set-points, and what is remembered of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rl.deploy.controller import PolicyController
from rl.deploy.forward import Policy
from rl.deploy.link import SILENCE_S, Telemetry
from rl.deploy.measurements import CONTROL_S, Measurements

Array = NDArray[np.float64]

REST_S = 0.5
"""Rest before a swim: a recording begins at rest, and velocities need a past."""
_SOON = 0.75
"""Share of the control period before which telemetry is not answered again."""


@dataclass(frozen=True)
class Track:
    """A swim, one row for each set-points sent.

    Attributes:
        t: Arrival of the telemetry on this computer in s, from the first, shape (T,).
        device_t: The robot's clock, shape (T,).
        command: Set-points sent in answer, shape (T, J).
        joint: Measured angles, shape (T, J), NaN where unseen.
        pose: x, y, heading, shape (T, 3), NaN where unseen.
        reached_s: When the target was reached, from the end of rest; None if it was not.
        closest_m: Smallest distance to the target; infinite if the swim never began.
        stopped: Why it ended early; None at the target or when the time was up.
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
        policy: The robot's.
        target: x and y in the pool's frame in m.
        seconds: Longest swim, after rest.
        arrive_m: Distance at which the target is reached.
        stopped: Why to end early, if there is a reason.
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
        self._seen = Measurements(self.policy.observation_limit)
        self._controller = PolicyController(self.policy)
        self._period: int | None = None
        self.rest: Array = np.clip(0.0, self.policy.low, self.policy.high).astype(np.float64)

    @property
    def swum_s(self) -> float:
        """Seconds since the end of rest, by the robot's clock; negative before."""
        return self._rows[-1][2].t_s - self._rows[0][2].t_s - REST_S if self._rows else -REST_S

    @property
    def over(self) -> bool:
        """Whether the swim has ended."""
        late = self.swum_s > self.seconds - CONTROL_S / 2
        return self.stopped is not None or self._reached_s is not None or late

    def answer(self, news: list[Telemetry], arrived_s: float) -> Array | None:
        """Set-points for the newest of what has arrived, shape (J,); None if it is nothing new."""
        fresh = [one for one in news if self._seen.take(one)]
        if not fresh:
            return None
        newest = fresh[-1]
        if self._rows and newest.t_s - self._rows[-1][2].t_s < _SOON * CONTROL_S:
            return None
        self._rows.append((arrived_s, self.rest, newest))
        if self.swum_s < -CONTROL_S / 2:
            return self.rest
        if self._seen.blind_s > SILENCE_S:
            self.stopped = f"robot or joints unseen for {SILENCE_S:g} s"
            return self.rest
        command = self._steered()
        self._rows[-1] = (arrived_s, command, newest)
        return command

    def _steered(self) -> Array:
        seen = self._seen.observation(self.target)
        distance = float(np.hypot(*seen[-2:]))
        self._closest_m = min(self._closest_m, distance)
        if distance < self.arrive_m:
            self._reached_s = max(self.swum_s, 0.0)
        if self.over:
            return self.rest
        period = round(self.swum_s / CONTROL_S)
        gone = 1 if self._period is None else period - self._period
        self._period = period
        return np.asarray(self._controller.act(seen[None], gone)[0], dtype=np.float64)

    def track(self) -> Track:
        """The swim so far."""
        J = len(self.rest)
        arrived = np.array([t for t, _, _ in self._rows])
        return Track(
            t=arrived - arrived[:1].sum(),
            device_t=np.array([seen.t_s for _, _, seen in self._rows]),
            command=np.array([sent for _, sent, _ in self._rows]).reshape(-1, J),
            joint=np.array([seen.joint for _, _, seen in self._rows]).reshape(-1, J),
            pose=np.array([seen.pose for _, _, seen in self._rows]).reshape(-1, 3),
            reached_s=self._reached_s,
            closest_m=self._closest_m,
            stopped=self.stopped,
        )
