"""Extraction of packets from any bytes, for protocols whose frames begin with a fixed header."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Generic, TypeVar

P = TypeVar("P")


class FrameDecoder(ABC, Generic[P]):
    """Extracts the valid packets from a stream of bytes, without raising errors.

    After a wrong length or checksum it continues at the next byte, so that a packet after noise, or
    after the start of another, is found. It buffers at most one frame.

    Args:
        longest: Largest number of bytes of a frame, by default that of the protocol; a larger
            length is an error. The smaller it is, the fewer packets a corrupted length hides.

    Attributes:
        header: First bytes of every frame.
        head_bytes: Number of bytes from which the size of a frame is known.
        largest: Largest number of bytes of a frame in the protocol.
        garbled: Number of headers without a valid packet.
        skipped: Number of bytes outside packets.
    """

    header: ClassVar[bytes]
    head_bytes: ClassVar[int]
    largest: ClassVar[int]

    def __init__(self, longest: int | None = None) -> None:
        self._longest = self.largest if longest is None else longest
        self._waiting = bytearray()
        self.garbled = 0
        self.skipped = 0

    @abstractmethod
    def size(self, head: bytes) -> int:
        """Bytes of the frame with these first bytes; 0 if there is no such frame."""

    @abstractmethod
    def packet(self, frame: bytes) -> P | None:
        """The packet in a frame; None if its check does not agree."""

    def feed(self, data: bytes) -> list[P]:
        """The packets that ``data`` completes, in order."""
        self._waiting += data
        packets = []
        start, end = 0, len(self._waiting)
        while True:
            begin = self._waiting.find(self.header, start)
            if begin < 0:
                begin = max(end - self._started(), start)
            self.skipped += begin - start
            start = begin
            if end - start < self.head_bytes:
                break
            size = self.size(bytes(self._waiting[start : start + self.head_bytes]))
            if size:
                if start + size > end:
                    break
                packet = self.packet(bytes(self._waiting[start : start + size]))
                if packet is not None:
                    packets.append(packet)
                    start += size
                    continue
            self.garbled += 1
            self.skipped += 1
            start += 1
        del self._waiting[:start]
        return packets

    def clear(self) -> None:
        """Discard an incomplete packet."""
        self.skipped += len(self._waiting)
        self._waiting.clear()

    def _started(self) -> int:
        """Bytes at the end that may be the start of a header."""
        lengths = range(len(self.header) - 1, 0, -1)
        return next((k for k in lengths if self._waiting.endswith(self.header[:k])), 0)
