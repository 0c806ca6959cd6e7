"""Virtual servos on one wire: their shafts, transmission times, noise and losses."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.hardware.frames import FrameDecoder, Instruction, Packet, Protocol

QUIET_S = 0.005
"""Silence after which an incomplete packet is discarded."""
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
    """A servo's shaft, at rest at ``angle`` in rad at the time ``now``.

    Times are in s, of one clock, and do not decrease; ``speed`` in rad/s is that of the last call.
    With the torque off the damping remains, and the shaft comes to rest.
    """

    def __init__(self, law: Law, now: float, angle: float = 0.0) -> None:
        self.law = law
        self.powered = False
        self.speed = 0.0
        self._time, self._angle = now, angle
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
    def drive_Nm(self) -> float:
        """Torque of the motor, without damping, at the time of the last call; 0 when off."""
        error = self._motion.at(self._time) - self._angle
        return self.law.kp_Nm_per_rad * error if self.powered else 0.0

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
        if arrived and abs(self.speed) < 1e-12 and abs(target - self._angle) < 1e-12:
            return
        q, v = self._angle, self.speed
        kp = law.kp_Nm_per_rad if self.powered else 0.0
        damping = 0.5 * h * law.kd_Nms_per_rad / law.inertia_kgm2
        push = h * kp / law.inertia_kgm2
        for k in range(count):
            q += 0.5 * h * v
            error = motion.at(begin + (k + 0.5) * h) - q
            v = ((1 - damping) * v + push * error) / (1 + damping)
            q += 0.5 * h * v
        self._angle, self.speed = q, v


class VirtualServo(ABC):
    """A virtual servo, at rest at its centre with its torque off at the time ``now``."""

    def __init__(
        self,
        servo_id: int,
        law: Law,
        now: float,
        *,
        supply_V: float = 7.4,
        temperature_C: float = 30.0,
        heating_C_per_s: float = 0.0,
    ) -> None:
        self.servo_id, self.connected = servo_id, True
        self._shaft, self._born = Shaft(law, now), now
        self._supply_V = supply_V
        self._temperature_C, self._heating = temperature_C, heating_C_per_s

    @property
    def powered(self) -> bool:
        """Whether its torque is on."""
        return self._shaft.powered

    @property
    def delay_s(self) -> float:
        """Time between the end of a request and the reply."""
        return 0.0

    def advance(self, now: float) -> None:
        """Advance the simulation to ``now``."""
        self._shaft.angle(now)

    @abstractmethod
    def handle(self, packet: Packet, now: float) -> Packet | None:
        """Process a packet; the reply, if there is one."""

    def _power(self, on: bool, now: float) -> None:
        self._shaft.hold(now)
        self._shaft.powered = on

    def _degrees(self, now: float) -> int:
        """Temperature in C, as one byte."""
        temperature = self._temperature_C + self._heating * (now - self._born)
        return min(max(round(temperature), 0), 255)


class VirtualBus:
    """Servos that share one wire.

    ``noise`` is the share of corrupted bytes in both directions, as many random bytes are inserted;
    ``loss`` that of lost packets. With ``echo`` the host receives its own bytes, as with a one-wire
    adapter; ``fast`` leaves out the time of the baud rate and the delay of replies.
    """

    def __init__(
        self,
        servos: Sequence[VirtualServo],
        protocol: Protocol,
        rng: np.random.Generator,
        *,
        baud: int,
        noise: float = 0.0,
        loss: float = 0.0,
        echo: bool = False,
        fast: bool = False,
    ) -> None:
        self.servos, self.baud = tuple(servos), baud
        self._protocol, self._decoder = protocol, FrameDecoder(protocol)
        self._rng, self._noise, self._loss = rng, noise, loss
        self._echo, self._fast = echo, fast
        self._heard = 0.0
        self._free = 0.0  # time at which the last byte has passed the wire

    def advance(self) -> None:
        """Advance all servos to the present time."""
        for servo in self.servos:
            servo.advance(time.monotonic())

    def receive(self, data: bytes) -> Iterator[bytes]:
        """Process bytes of the host; yields each reply after its transmission time.

        A servo acts on a packet when its last byte has arrived, by the time of the wire: delays of
        this program do not add up.
        """
        now = time.monotonic()
        if now - self._heard > QUIET_S:
            self._decoder.clear()
        self._heard = now
        self._free = max(self._free, now)
        if self._echo:
            yield data
        for packet in self._decoder.feed(self._spoil(data)):
            self._wait(len(packet.parameters) + self._protocol.overhead)
            if self._rng.random() < self._loss:
                continue
            servos, ids = self.servos, packet.parameters
            if packet.code == Instruction.SYNC_READ:  # they reply in the order of their identities
                servos = tuple(sorted(servos, key=lambda one: ids.rfind(bytes((one.servo_id,)))))
            replies = [(servo, servo.handle(packet, self._free)) for servo in servos]
            for servo, reply in replies:
                if reply is not None and self._rng.random() >= self._loss:
                    answer = self._protocol.encode(reply)
                    self._wait(len(answer), servo.delay_s)
                    yield self._spoil(answer)
        self._heard = time.monotonic()

    def _spoil(self, data: bytes) -> bytes:
        """The bytes after the noise of the line."""
        if not self._noise:
            return data
        spoilt = bytearray()
        for byte in data:
            if self._rng.random() < self._noise:  # a stray one
                spoilt.append(int(self._rng.integers(256)))
            hit = self._rng.random() < self._noise
            spoilt.append(int(self._rng.integers(256)) if hit else byte)
        return bytes(spoilt)

    def _wait(self, count: int, delay_s: float = 0.0) -> None:
        if not self._fast:
            self._free += 10 * count / self.baud + delay_s
            time.sleep(max(self._free - time.monotonic(), 0.0))
