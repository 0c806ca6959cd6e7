"""Virtual servos on one wire, with transmission times, noise and losses."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from sim2real.hardware.frames import FrameDecoder


class _Parameters(Protocol):
    @property
    def parameters(self) -> bytes: ...


P = TypeVar("P", bound=_Parameters)
QUIET_S = 0.005
"""Silence after which an incomplete packet is discarded."""


class OnWire(Protocol[P]):
    """A virtual servo.

    Attributes:
        servo_id: Identity.
        connected: False for a disconnected servo, which receives and sends nothing.
        powered: Whether its torque is on.
        delay_s: Time between the end of a request and the reply.
    """

    servo_id: int
    connected: bool

    @property
    def delay_s(self) -> float:
        """Time between the end of a request and the reply."""

    @property
    def powered(self) -> bool:
        """Whether its torque is on."""

    def advance(self, now: float) -> None:
        """Advance the simulation to ``now``."""

    def handle(self, packet: P, now: float) -> P | None:
        """Process a packet; the reply, if there is one."""


@dataclass(frozen=True)
class Speech(Generic[P]):
    """How servos of a protocol are spoken to.

    Attributes:
        decoder: Makes a decoder.
        encode: Encodes a packet.
        overhead: Bytes of a packet besides its parameters.
        order: Identities in the order in which they reply to a packet; empty for any order.
    """

    decoder: Callable[[], FrameDecoder[P]]
    encode: Callable[[P], bytes]
    overhead: int
    order: Callable[[P], Sequence[int]] = lambda packet: ()


class VirtualBus(Generic[P]):
    """Servos that share one wire.

    Args:
        servos: The servos.
        speech: Their protocol.
        rng: Random number generator.
        noise: Share of corrupted bytes in both directions; as many random bytes are inserted.
        loss: Share of lost packets in both directions.
        echo: Whether the host receives an echo, as with a one-wire adapter.
        baud: Bits per second.
        fast: Transmit without the time of the baud rate, and reply without delay.
    """

    def __init__(
        self,
        servos: Sequence[OnWire[P]],
        speech: Speech[P],
        rng: np.random.Generator,
        *,
        baud: int,
        noise: float = 0.0,
        loss: float = 0.0,
        echo: bool = False,
        fast: bool = False,
    ) -> None:
        self.servos, self.baud = tuple(servos), baud
        self._speech, self._decoder = speech, speech.decoder()
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
        for packet in self._decoder.feed(self.spoil(data)):
            self._wait(len(packet.parameters) + self._speech.overhead)
            if self.lost():
                continue
            replies = [(servo, servo.handle(packet, self._free)) for servo in self._ordered(packet)]
            for servo, reply in replies:
                if reply is not None and not self.lost():
                    answer = self._speech.encode(reply)
                    self._wait(len(answer), servo.delay_s)
                    yield self.spoil(answer)
        self._heard = time.monotonic()

    def lost(self) -> bool:
        """Whether the next packet is lost."""
        return bool(self._rng.random() < self._loss)

    def spoil(self, data: bytes) -> bytes:
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

    def _ordered(self, packet: P) -> list[OnWire[P]]:
        order = list(self._speech.order(packet))
        if not order:
            return list(self.servos)
        named = [servo for servo in self.servos if servo.servo_id in order]
        return sorted(named, key=lambda servo: order.index(servo.servo_id))

    def _wait(self, count: int, delay_s: float = 0.0) -> None:
        if not self._fast:
            self._free += 10 * count / self.baud + delay_s
            time.sleep(max(self._free - time.monotonic(), 0.0))
