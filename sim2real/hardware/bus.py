"""A bus of LX servos: requests and replies with deadlines."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType

from sim2real.hardware.lx import Decoder, Packet, encode, expects_reply, is_reply
from sim2real.hardware.transport import Transport


class Bus:
    """Requests and replies over one transport. A missing reply is None and counted.

    On one wire the host receives an echo of what it sends; an echo lacks the parameters of a reply
    and is ignored, as is any other unexpected packet.

    Args:
        transport: The transport, which the bus closes.

    Attributes:
        asked: Number of expected replies.
        missed: Number of expected replies that did not arrive in time.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._decoder = Decoder()
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

    def exchange(self, packets: Sequence[Packet], deadline: float) -> list[Packet | None]:
        """Send packets together and wait for the replies.

        Args:
            packets: Packets in order; if not ``together``, only the last may be a request.
            deadline: Time limit, by ``time.monotonic``.

        Returns:
            The reply to each packet; None if it is missing or none was expected.

        Raises:
            OSError: If the port is lost.
        """
        replies: list[Packet | None] = [None] * len(packets)
        due = [k for k, packet in enumerate(packets) if expects_reply(packet)]
        self.asked += len(due)
        self._transport.write(b"".join(encode(packet) for packet in packets))
        while due:
            data = self._transport.read(deadline)
            if not data:
                break
            for packet in self._decoder.feed(data):
                k = next((k for k in due if is_reply(packets[k], packet)), None)
                if k is not None:
                    replies[k] = packet
                    due.remove(k)
            if due and time.monotonic() > deadline:
                break
        self.missed += len(due)
        return replies

    def ask(self, servo_id: int, command: int, within_s: float) -> Packet | None:
        """The reply of one servo to one request, or None."""
        return self.exchange([Packet(servo_id, command)], time.monotonic() + within_s)[0]

    def drain(self) -> None:
        """Discard late replies, so that they are not taken for replies to later requests."""
        deadline = time.monotonic() + 0.001
        while self._transport.read(0.0) and time.monotonic() < deadline:
            pass
        self._decoder.clear()

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._transport.close()
