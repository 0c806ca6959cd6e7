"""A bus of LX servos: packets out, replies in, never later than a deadline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType

from sim2real.hardware.lx import Decoder, Packet, encode, expects_reply, is_reply
from sim2real.hardware.transport import Transport


class Bus:
    """Requests and replies over one transport. A reply that does not come is None and counted.

    On one wire the host hears what it sends; an echo is no reply, as it lacks the reply's bytes,
    and is passed over like anything else that was not asked for.

    Args:
        transport: What carries the bytes; the bus closes it.

    Attributes:
        asked: Number of replies that were due.
        missed: Number of those that did not come in time.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._decoder = Decoder()
        self.asked = 0
        self.missed = 0

    @property
    def together(self) -> bool:
        """Whether one exchange may ask several servos."""
        return self._transport.together

    @property
    def device_s(self) -> float | None:
        """The far side's clock at the last answered exchange, if it tells."""
        return self._transport.device_s

    @property
    def garbled(self) -> int:
        """Number of packets that came spoilt."""
        return self._decoder.garbled

    def exchange(self, packets: Sequence[Packet], deadline: float) -> list[Packet | None]:
        """Send packets in one go and wait for the replies.

        Args:
            packets: What to send, in order; where not ``together``, only the last may ask.
            deadline: When to give up, by ``time.monotonic``.

        Returns:
            The reply to each packet; None where none came or none was due.

        Raises:
            OSError: If the port is gone.
        """
        replies: list[Packet | None] = [None] * len(packets)
        due = [k for k, packet in enumerate(packets) if expects_reply(packet)]
        self.asked += len(due)
        self._transport.write(b"".join(encode(packet) for packet in packets))
        while due:
            data = self._transport.read(deadline)
            if not data:
                break
            for found in self._decoder.feed(data):
                k = next((k for k in due if is_reply(packets[k], found)), None)
                if k is not None:
                    replies[k] = found
                    due.remove(k)
            if due and time.monotonic() > deadline:
                break
        self.missed += len(due)
        return replies

    def ask(self, servo_id: int, command: int, within_s: float) -> Packet | None:
        """The reply of one servo to one request, or None."""
        return self.exchange([Packet(servo_id, command)], time.monotonic() + within_s)[0]

    def drain(self) -> None:
        """Throw away what came too late, so that it answers nothing asked from now on."""
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
