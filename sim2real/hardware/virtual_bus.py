"""Virtual servos on one wire, with transmission times, noise and losses."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from sim2real.hardware.lx import BYTE_S, Decoder, encode
from sim2real.hardware.virtual_servo import VirtualServo

QUIET_S = 0.005
"""Silence after which an incomplete packet is discarded."""


class VirtualBus:
    """Servos that share one wire.

    Args:
        servos: The servos.
        rng: Random number generator.
        noise: Share of corrupted bytes in both directions; as many random bytes are inserted.
        loss: Share of lost packets in both directions.
        echo: Whether the host receives an echo, as with a one-wire adapter.
        byte_s: Transmission time of a byte.
    """

    def __init__(
        self,
        servos: Sequence[VirtualServo],
        rng: np.random.Generator,
        *,
        noise: float = 0.0,
        loss: float = 0.0,
        echo: bool = False,
        byte_s: float = BYTE_S,
    ) -> None:
        self.servos = tuple(servos)
        self._rng, self._noise, self._loss = rng, noise, loss
        self._echo, self._byte_s = echo, byte_s
        self._decoder = Decoder()
        self._heard = 0.0

    def advance(self) -> None:
        """Advance all servos to the present time."""
        for servo in self.servos:
            servo.advance(time.monotonic())

    def receive(self, data: bytes) -> Iterator[bytes]:
        """Process bytes of the host; yields each reply after its transmission time.

        A servo acts on a packet when its last byte has arrived.
        """
        now = time.monotonic()
        if now - self._heard > QUIET_S:
            self._decoder.clear()
        self._heard = now
        if self._echo:
            yield data
        for packet in self._decoder.feed(self.spoil(data)):
            self._wire(len(packet.parameters) + 6)
            if self.lost():
                continue
            for servo in self.servos:
                reply = servo.handle(packet, time.monotonic())
                if reply is not None and not self.lost():
                    answer = encode(reply)
                    self._wire(len(answer))
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

    def _wire(self, count: int) -> None:
        if self._byte_s:
            time.sleep(count * self._byte_s)
