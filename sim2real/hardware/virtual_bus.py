"""Virtual servos on one wire: shafts, transmission times, noise, losses; served to a host."""

import contextlib
import math
import os
import select
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.errors import InputError
from sim2real.hardware.frames import FrameDecoder, Instruction, Packet, Protocol
from sim2real.hardware.radio import LARGEST, VirtualRadio, opened

QUIET_S = 0.005
"""Silence after which an incomplete packet is discarded."""
LONGEST_STEP_S = 0.0005
TICK_S = 0.02  # period of the simulation without requests


@dataclass(frozen=True)
class Law:
    """torque = kp (set-point(t - latency) - angle) - kd speed, on a known inertia."""

    kp_Nm_per_rad: float = 2.2
    kd_Nms_per_rad: float = 0.06
    latency_s: float = 0.06
    inertia_kgm2: float = 0.002


class Shaft:
    """A servo's shaft, at rest at ``angle`` in rad at the time ``now``.

    Times are in s, of one clock, and do not decrease; ``speed`` in rad/s is that of the last call.
    With the torque off the damping remains, and the shaft comes to rest.
    """

    def __init__(self, law: Law, now: float, angle: float = 0.0) -> None:
        self.law, self.powered, self.speed = law, False, 0.0
        self._time, self._angle, self._target = now, angle, angle
        self._coming: deque[tuple[float, float]] = deque()  # set-points, each with its time

    def command(self, now: float, angle: float) -> None:
        """Set a set-point, which takes effect after the latency."""
        self._coming.append((now + self.law.latency_s, angle))

    def power(self, on: bool, now: float) -> None:
        """Switch the torque on or off, where it is."""
        self.hold(now)
        self.powered = on

    def hold(self, now: float) -> None:
        """Make the present angle the set-point, and discard pending set-points."""
        self._target = self.angle(now)
        self._coming.clear()

    def angle(self, now: float) -> float:
        """Angle in rad at ``now``."""
        while self._coming and self._coming[0][0] <= now:
            start, target = self._coming.popleft()
            self._advance(start)
            self._target = target
        self._advance(now)
        return self._angle

    @property
    def drive_Nm(self) -> float:
        """Torque of the motor, without damping, at the time of the last call; 0 when off."""
        return self.law.kp_Nm_per_rad * (self._target - self._angle) if self.powered else 0.0

    def _advance(self, until: float) -> None:
        """Substeps of the midpoint rule with trapezoidal damping, as in ``servo.law.substep``."""
        q, v, law, target = self._angle, self.speed, self.law, self._target
        kp, lag, self._time = law.kp_Nm_per_rad, until - self._time, max(until, self._time)
        if not self.powered:
            kp, target = 0.0, q
        if lag <= 0 or (abs(v) < 1e-12 and abs(target - q) < 1e-12):
            return
        count = math.ceil(lag / LONGEST_STEP_S)
        h = lag / count
        damping = 0.5 * h * law.kd_Nms_per_rad / law.inertia_kgm2
        push = h * kp / law.inertia_kgm2
        for _ in range(count):
            q += 0.5 * h * v
            v = ((1 - damping) * v + push * (target - q)) / (1 + damping)
            q += 0.5 * h * v
        self._angle, self.speed = q, v


class VirtualServo(Shaft, ABC):
    """A virtual servo, at rest at its centre with its torque off at the time ``now``."""

    delay_s = 0.0
    """Time between the end of a request and the reply."""

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
        super().__init__(law, now)
        self.servo_id, self.connected = servo_id, True
        self._born, self._supply_V = now, supply_V
        self._temperature_C, self._heating = temperature_C, heating_C_per_s

    def advance(self, now: float) -> None:
        """Advance the simulation to ``now``."""
        self.angle(now)

    @abstractmethod
    def handle(self, packet: Packet, now: float) -> Packet | None:
        """Process a packet; the reply, if there is one."""

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


def serve_terminal(
    bus: VirtualBus, announce: Callable[[str], object], stop: Callable[[], bool]
) -> None:
    """Serve a pseudo-terminal until ``stop``; ``announce`` is called with its name."""
    try:
        import tty

        host, device = os.openpty()
    except (ImportError, AttributeError, OSError):
        expected = "a system that has them, or --udp"
        raise InputError("virtual-servo", "", "no pseudo-terminals", expected) from None
    try:
        tty.setraw(device)
        os.set_blocking(host, False)
        announce(os.ttyname(device))
        while not stop():
            if select.select([host], [], [], TICK_S)[0]:
                data = os.read(host, LARGEST)
                for reply in bus.receive(data) if _rate(device) in (None, bus.baud) else ():
                    with contextlib.suppress(BlockingIOError):  # no reader: the reply is lost
                        os.write(host, reply)
            bus.advance()
    finally:
        os.close(host)
        os.close(device)


def _rate(device: int) -> int | None:
    """Rate that the host has set; None if it has set none, or an unusual one."""
    import termios

    speed = termios.tcgetattr(device)[4]
    if speed == termios.B38400:  # of a new pseudo-terminal
        return None
    names = {getattr(termios, name): name for name in dir(termios) if name[:1] == "B"}
    name = names.get(speed, "")[1:]
    return int(name) if name.isdigit() else None


def serve_udp(
    bus: VirtualBus,
    address: str,
    announce: Callable[[str], object],
    stop: Callable[[], bool],
    *,
    rng: np.random.Generator,
    loss: float = 0.0,
    key: bytes | None = None,
) -> None:
    """Serve a radio at HOST:PORT until ``stop``; it loses this share of datagrams each way."""
    radio, expected = VirtualRadio(key), "HOST:PORT of this computer, as 127.0.0.1:0"
    with opened(f"udp://{address}", "--udp", expected, bind=True) as end:
        host, port = end.getsockname()
        announce(f"udp://{host}:{port}")
        while not stop():
            if select.select([end], [], [], TICK_S)[0]:
                with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                    datagram, sender = end.recvfrom(LARGEST)
                    clock = time.monotonic()
                    heard = rng.random() >= loss
                    packets = radio.receive(datagram, sender, clock) if heard else None
                    if packets is not None:
                        reply = radio.answer(clock, b"".join(bus.receive(packets)))
                        if rng.random() >= loss:
                            end.sendto(reply, sender)
            bus.advance()
