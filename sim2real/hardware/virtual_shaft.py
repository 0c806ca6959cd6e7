"""Motion of a virtual servo's shaft: the PD law with latency, simulated in real time."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

LONGEST_STEP_S = 0.0005


@dataclass(frozen=True)
class Law:
    """torque = kp (set-point(t - latency) - angle) - kd speed, on a known inertia."""

    kp_Nm_per_rad: float = 2.2
    kd_Nms_per_rad: float = 0.06
    latency_s: float = 0.06
    inertia_kgm2: float = 0.002


@dataclass(frozen=True)
class _Motion:
    """A motion of the set-point at constant speed that takes effect at ``start``."""

    start: float
    origin: float
    target: float
    duration: float

    def at(self, time: float) -> float:
        if time >= self.start + self.duration:
            return self.target
        return self.origin + (self.target - self.origin) * (time - self.start) / self.duration


class Shaft:
    """A servo's shaft. Times are in s, of one clock, and do not decrease.

    With the torque off the damping remains, and the shaft comes to rest.

    Args:
        law: Gains, latency and inertia.
        now: Present time.
        angle: Initial angle in rad.
    """

    def __init__(self, law: Law, now: float, angle: float = 0.0) -> None:
        self.law = law
        self.powered = False
        self._time, self._angle, self._speed = now, angle, 0.0
        self._motion = _Motion(now, angle, angle, 0.0)
        self._coming: deque[_Motion] = deque()

    def command(self, now: float, angle: float, duration: float = 0.0) -> None:
        """Set a set-point, reached at constant speed in ``duration``, after the latency."""
        start = now + self.law.latency_s
        origin = (self._coming[-1] if self._coming else self._motion).at(start)
        self._coming.append(_Motion(start, origin, angle, duration))

    def hold(self, now: float) -> None:
        """Make the present angle the set-point, and discard pending set-points."""
        angle = self.angle(now)
        self._coming.clear()
        self._motion = _Motion(now, angle, angle, 0.0)

    def angle(self, now: float) -> float:
        """Angle in rad at ``now``."""
        while self._coming and self._coming[0].start <= now:
            self._advance(self._coming[0].start)
            self._motion = self._coming.popleft()
        self._advance(now)
        return self._angle

    @property
    def speed(self) -> float:
        """Speed in rad/s at the time of the last call."""
        return self._speed

    @property
    def drive_Nm(self) -> float:
        """Torque of the motor, without damping, at the time of the last call; 0 when off."""
        if not self.powered:
            return 0.0
        return self.law.kp_Nm_per_rad * (self._motion.at(self._time) - self._angle)

    def _advance(self, until: float) -> None:
        """Substeps of the midpoint rule with trapezoidal damping, as in ``servo.law.substep``."""
        if until <= self._time:
            return
        count = math.ceil((until - self._time) / LONGEST_STEP_S)
        h = (until - self._time) / count
        law, motion, begin = self.law, self._motion, self._time
        self._time = until
        target = motion.target if self.powered else self._angle
        arrived = begin >= motion.start + motion.duration or not self.powered
        if arrived and abs(self._speed) < 1e-12 and abs(target - self._angle) < 1e-12:
            return
        q, v = self._angle, self._speed
        kp = law.kp_Nm_per_rad if self.powered else 0.0
        damping = 0.5 * h * law.kd_Nms_per_rad / law.inertia_kgm2
        push = h * kp / law.inertia_kgm2
        for k in range(count):
            q += 0.5 * h * v
            error = motion.at(begin + (k + 0.5) * h) - q
            v = ((1 - damping) * v + push * error) / (1 + damping)
            q += 0.5 * h * v
        self._angle, self._speed = q, v
