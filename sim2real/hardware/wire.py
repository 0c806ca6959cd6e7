"""Packets over a transport: requests and replies with deadlines."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

from sim2real.hardware.frames import FrameDecoder
from sim2real.hardware.transport import Transport

P = TypeVar("P")


class Wire(Generic[P]):
    """Requests and replies over one transport. A missing reply is None and counted.

    Unexpected packets are ignored, such as the echo of a request on a single wire.

    Args:
        transport: The transport, which the wire closes.
        decoder: Decoder of what arrives.

    Attributes:
        asked: Number of expected replies.
        missed: Number of expected replies that did not arrive in time.
    """

    def __init__(self, transport: Transport, decoder: FrameDecoder[P]) -> None:
        self._transport = transport
        self._decoder = decoder
        self.asked = 0
        self.missed = 0

    @property
    def together(self) -> bool:
        """Whether one exchange may address several servos."""
        return self._transport.together

    @property
    def device_s(self) -> float | None:
        """Clock of the remote device at the last answered exchange, if it sends one."""
        return self._transport.device_s

    @property
    def garbled(self) -> int:
        """Number of corrupted packets."""
        return self._decoder.garbled

    def exchange(
        self, data: bytes, expected: Sequence[Callable[[P], bool]], deadline: float
    ) -> list[P | None]:
        """Send bytes and wait for the replies.

        Args:
            data: Encoded requests.
            expected: For each expected reply whether a packet is that reply.
            deadline: Time limit, by ``time.monotonic``.

        Returns:
            The expected replies in order; None for those that are missing.

        Raises:
            OSError: If the port is lost.
        """
        replies: list[P | None] = [None] * len(expected)
        due = list(range(len(expected)))
        self.asked += len(due)
        self._transport.write(data)
        while due:
            arrived = self._transport.read(deadline)
            if not arrived:
                break
            for packet in self._decoder.feed(arrived):
                k = next((k for k in due if expected[k](packet)), None)
                if k is not None:
                    replies[k] = packet
                    due.remove(k)
            if due and time.monotonic() > deadline:
                break
        self.missed += len(due)
        return replies

    def drain(self, quiet_s: float = 0.0) -> None:
        """Discard late replies, so that they are not taken for replies to later requests.

        Args:
            quiet_s: Silence to wait for.
        """
        deadline = time.monotonic() + 0.001 + 5 * quiet_s
        while self._transport.read(time.monotonic() + quiet_s) and time.monotonic() < deadline:
            pass
        self._decoder.clear()

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()
