"""Control of one robot to a target over the network, without PyTorch."""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rl.deploy.link import SILENCE_S, Link, Telemetry
from rl.deploy.policy import Policy, PolicyController
from rl.observer import CONTROL_S, observed
from sim2real.arrays import Array, Array32
from sim2real.velocity import NEWEST, slope_weights

ARRIVE_M = 0.05
"""Distance at which the target is reached."""
REST_S = 0.5
"""Rest before a swim: a recording starts at rest, and velocities need past measurements."""
ANSWER_S = 3.0
"""Time within which the robot must answer first."""
_SOON = 0.75
"""Share of the control period before which telemetry is not answered again."""


class Measurements:
    """The last measurements of one robot; ``limit`` are the bounds of the observation, (O,)."""

    def __init__(self, limit: Array32) -> None:
        self._limit = limit
        self._t: deque[float] = deque(maxlen=64)
        self._rows: deque[Array] = deque(maxlen=64)

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
        t, measured = np.array(self._t), np.isfinite(np.array(self._rows))
        if not measured.any(axis=0).all():
            return math.inf
        return float(t[-1] - min(t[column].max() for column in measured.T))

    def observation(self, target: Array) -> Array32:
        """The task's columns, shape (O,), gaps interpolated; the target is x and y in m."""
        t, rows = np.array(self._t), np.array(self._rows)
        grid = t[-1] + CONTROL_S * np.arange(1 - NEWEST, 1)
        past = np.empty((1, NEWEST, rows.shape[1]))
        for k, column in enumerate(rows.T):
            measured = np.isfinite(column)
            if not measured.any():
                raise ValueError(f"column {k} of pose and angles was never measured")
            values = np.unwrap(column[measured]) if k == 2 else column[measured]
            past[0, :, k] = np.interp(grid, t[measured], values)
        columns = observed(past, slope_weights(NEWEST, CONTROL_S), target[None], self._limit)
        return np.asarray(columns[0], dtype=np.float32)


class Track(NamedTuple):
    """Record of a swim: T set-point messages, their times and the distance to the target."""

    t: Array  # arrival of the telemetry on this computer in s, from the first
    device_t: Array  # the robot's clock in s
    inference_s: Array  # time from the arrival until set-points were sent in answer
    command: Array  # these in rad, shape (T, J)
    joint: Array  # measured angles, shape (T, J), NaN if missing
    pose: Array  # measured pose, shape (T, 3), likewise
    reached_s: float | None  # from the end of rest
    closest_m: float  # infinite if the swim never started
    stopped: str | None


class Pilot:
    """Answers telemetry until the robot is at the target, x and y in m, or ``seconds`` are over."""

    def __init__(self, policy: Policy, target: Array, seconds: float) -> None:
        self.policy, self.target, self.seconds = policy, target, seconds
        self.rest: Array = np.clip(0.0, policy.low, policy.high).astype(np.float64)
        self.stopped: str | None = None
        self._reached_s: float | None = None
        self._closest_m, self._period = math.inf, -1
        self._rows: list[tuple[float, Array, Telemetry]] = []
        self.inference_s: list[float] = []  # of each row, from whoever sends its set-points
        self._measurements = Measurements(policy.observation_limit)
        self._controller = PolicyController(policy)

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
        if distance < ARRIVE_M:
            self._reached_s = max(self.elapsed_s, 0.0)
        if self.over:
            return self.rest
        before, self._period = self._period, round(self.elapsed_s / CONTROL_S)
        sent = self._controller.act(observation[None], self._period - before)
        return np.asarray(sent[0], dtype=np.float64)

    def track(self) -> Track:
        """Record of the swim so far."""
        J, news = len(self.rest), [telemetry for _, _, telemetry in self._rows]
        arrived = np.array([t for t, _, _ in self._rows])
        return Track(
            arrived - arrived[:1].sum(),
            np.array([telemetry.t_s for telemetry in news]),
            np.array([*self.inference_s, *[math.nan] * len(news)])[: len(news)],
            np.array([sent for _, sent, _ in self._rows]).reshape(-1, J),
            np.array([telemetry.joint for telemetry in news]).reshape(-1, J),
            np.array([telemetry.pose for telemetry in news]).reshape(-1, 3),
            self._reached_s, self._closest_m, self.stopped,
        )  # fmt: skip


def swim(
    link: Link,
    pilot: Pilot,
    *,
    interrupted: Callable[[], bool] = lambda: False,
    progress: Callable[[float], object] = lambda _: None,
) -> Track | None:
    """Drive the robot until the pilot has finished; finally, and after any error, send it to rest.

    Telemetry is answered at once. ``interrupted`` says whether the user has asked to stop,
    ``progress`` is called with the seconds since its last call. None if the robot never answered.
    """
    news, deadline = list[Telemetry](), time.monotonic() + ANSWER_S
    while not news:
        if time.monotonic() >= deadline:
            return None
        if interrupted():
            raise KeyboardInterrupt
        link.begin()
        news = link.receive(0.1)
    answered = time.monotonic()
    try:
        while not pilot.over:
            before, time_s = pilot.elapsed_s, time.monotonic()
            command = pilot.answer(news, time_s)
            if command is not None:
                answered = time_s
                link.send(command)
                pilot.inference_s.append(time.monotonic() - time_s)
                progress(max(pilot.elapsed_s, 0.0) - max(before, 0.0))
            elif time_s - answered > SILENCE_S:
                pilot.stopped = f"no answer from the robot for {SILENCE_S:g} s"
            if interrupted():
                pilot.stopped = "interrupted"
            if not pilot.over:
                news = link.receive(SILENCE_S / 10)
    finally:
        for _ in range(5):  # datagrams may be lost
            link.send(pilot.rest)
            time.sleep(CONTROL_S)
    return pilot.track()
