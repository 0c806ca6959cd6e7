"""Packets out of a stream of bytes that comes in pieces and may hold garbage."""

from __future__ import annotations

from sim2real.hardware.lx import HEADER, LONGEST, SHORTEST, Packet, checksum


class Decoder:
    """Finds whole packets with a right checksum; whatever else it is fed, it raises nothing.

    After a wrong length or checksum it goes on looking one byte further, so that a packet behind
    noise, or behind the beginning of another, is found. It never holds more than nine bytes back.

    Attributes:
        garbled: Number of headers that no packet followed.
        skipped: Number of bytes that belonged to no packet.
    """

    def __init__(self) -> None:
        self._waiting = bytearray()
        self.garbled = 0
        self.skipped = 0

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that ``data`` completes, in order."""
        self._waiting += data
        packets = []
        start, end = 0, len(self._waiting)
        while True:
            found = self._waiting.find(HEADER, start)
            if found < 0:
                found = end - self._waiting.endswith(HEADER[:1])
                self.skipped += max(found - start, 0)
                start = max(found, start)
                break
            self.skipped += found - start
            start = found
            length = self._waiting[start + 3] if end - start > 3 else None
            if length is None:
                break
            stop = start + len(HEADER) + 1 + length
            if SHORTEST <= length <= LONGEST:
                if stop > end:
                    break
                body = bytes(self._waiting[start + len(HEADER) : stop - 1])
                if checksum(body) == self._waiting[stop - 1]:
                    packets.append(Packet(body[0], body[2], body[3:]))
                    start = stop
                    continue
            self.garbled += 1
            self.skipped += 1
            start += 1
        del self._waiting[:start]
        return packets

    def clear(self) -> None:
        """Forget the beginning of a packet: its end is not to come any more."""
        self.skipped += len(self._waiting)
        self._waiting.clear()
