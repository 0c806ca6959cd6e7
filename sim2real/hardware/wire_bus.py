"""What the buses share: packets on a wire, and requests that are repeated until an answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Generic, TypeVar

from sim2real.hardware.frames import FrameDecoder
from sim2real.hardware.servo_bus import INSISTENCE, Stopped
from sim2real.hardware.transport import Transport
from sim2real.hardware.wire import Wire

P = TypeVar("P")
T = TypeVar("T")
QUIET_S = 0.02
"""Silence after a missing answer before the next request."""


class WireBus(Generic[P]):
    """A bus of servos on a wire.

    Args:
        transport: The transport, which the bus closes.
        decoder: Decoder of the servos' packets.
        baud: Bits per second.
    """

    name: ClassVar[str]

    def __init__(self, transport: Transport, decoder: FrameDecoder[P], baud: int) -> None:
        self.wire: Wire[P] = Wire(transport, decoder)
        self._baud = baud

    @property
    def garbled(self) -> int:
        """Number of corrupted packets until now."""
        return self.wire.garbled

    def close(self) -> None:
        """Close the port."""
        self.wire.close()

    def _insist(self, servo_id: int, ask: Callable[[], T | None]) -> T:
        """The first answer of a servo that must answer."""
        answer = self._insisted(ask)
        if answer is None:
            raise Stopped(f"no reply from servo {servo_id} ({self.name}, {self._baud} baud)")
        return answer

    def _insisted(self, ask: Callable[[], T | None]) -> T | None:
        for _ in range(INSISTENCE):
            answer = ask()
            if answer is not None:
                return answer
            self.wire.drain(QUIET_S)  # a late answer would pass for that to another request
        return None

    def _wire_s(self, count: int) -> float:
        """Time of so many bytes on the wire, with start and stop bits."""
        return 10 * count / self._baud
