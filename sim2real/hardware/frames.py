"""Frames of the servos' protocols: packets to bytes, and packets found in any bytes."""

from dataclasses import dataclass
from enum import IntEnum

BROADCAST = 254


@dataclass(frozen=True, slots=True)
class Packet:
    """An instruction or an answer; ``code`` of a Feetech servo's answer is its error byte."""

    servo_id: int
    code: int
    parameters: bytes = b""


class Instruction(IntEnum):
    """Instructions of Dynamixel and Feetech servos."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    STATUS = 0x55  # the answer of a Dynamixel servo
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


@dataclass(frozen=True)
class Protocol:
    """Frames of a header, identity, length, code, parameters and a checksum.

    The checksum is the complement of the sum of everything between header and checksum, in one
    byte; the length counts all but the first ``uncounted`` bytes.
    """

    header: bytes  # first bytes of every frame
    head: int  # number of bytes from which the size of a frame is known
    overhead: int  # bytes of a frame besides the parameters, without stuffing
    largest: int  # largest number of bytes of a frame
    largest_id: int  # largest identity of a servo
    uncounted: int  # bytes that the length does not count

    def encode(self, packet: Packet) -> bytes:
        """The packet as bytes; ``ValueError`` for a wrong identity or too many parameters."""
        if not 0 <= packet.servo_id <= BROADCAST or self.largest_id < packet.servo_id < BROADCAST:
            raise ValueError(f"servo {packet.servo_id}: identities run from 0 to {self.largest_id}")
        if len(packet.parameters) + self.overhead > self.largest:
            raise ValueError(f"{len(packet.parameters)} bytes of parameters are too many")
        return self._framed(packet)

    def size(self, head: bytes) -> int:
        """Bytes of the frame with these first bytes."""
        return head[3] + self.uncounted if head[2] <= BROADCAST else 0

    def packet(self, frame: bytes) -> Packet | None:
        """The packet in a frame; None if its check does not agree."""
        body = frame[len(self.header) : -1]
        return Packet(body[0], body[2], body[3:]) if ~sum(body) & 0xFF == frame[-1] else None

    def _framed(self, packet: Packet) -> bytes:
        length = len(packet.parameters) + self.overhead - self.uncounted
        body = bytes((packet.servo_id, length, packet.code)) + packet.parameters
        return self.header + body + bytes((~sum(body) & 0xFF,))


class Protocol2(Protocol):
    """Header, identity, length, instruction, parameters, CRC-16; low bytes first.

    Where the body contains ``FF FF FD``, a byte ``FD`` is inserted after it, so that no header
    occurs inside a frame (https://emanual.robotis.com/docs/en/dxl/protocol2/).
    """

    def _framed(self, packet: Packet) -> bytes:
        body = bytes((packet.code,)) + packet.parameters
        body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        frame = self.header + bytes((packet.servo_id,)) + (len(body) + 2).to_bytes(2, "little")
        return frame + body + crc16(frame + body).to_bytes(2, "little")

    def size(self, head: bytes) -> int:
        """Bytes of the frame with these first bytes."""
        return int.from_bytes(head[5:7], "little") + self.uncounted if head[4] <= BROADCAST else 0

    def packet(self, frame: bytes) -> Packet | None:
        """The packet in a frame; None if its CRC does not agree."""
        if crc16(frame[:-2]) != int.from_bytes(frame[-2:], "little"):
            return None
        body = frame[self.head : -2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return Packet(frame[4], body[0], body[1:])


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 8005 (hexadecimal), starting at 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x8005 if crc & 0x8000 else 0)
        crc &= 0xFFFF
    return crc


# the length of LX servos counts itself; manuals of the LX-16A and of Feetech's serial bus servos
LX = Protocol(b"\x55\x55", 4, 6, 10, 253, uncounted=3)
FEETECH = Protocol(b"\xff\xff", 4, 6, 256, 253, uncounted=4)
DYNAMIXEL = Protocol2(b"\xff\xff\xfd\x00", 7, 10, 1024, 252, uncounted=7)


class FrameDecoder:
    """Extracts the valid packets from a stream of bytes, without raising errors.

    After a wrong length or checksum, counted as ``garbled``, it continues at the next byte, so that
    a packet after noise is found. It buffers at most one frame, of ``longest`` bytes. The smaller
    that is, the fewer packets a corrupted length hides.
    """

    def __init__(self, protocol: Protocol, longest: int | None = None) -> None:
        self._protocol, self._longest = protocol, longest or protocol.largest
        self._waiting = bytearray()
        self.garbled = 0

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that ``data`` completes, in order."""
        self._waiting += data
        protocol, packets = self._protocol, []
        start, end = 0, len(self._waiting)
        while True:
            begin = self._waiting.find(protocol.header, start)
            if begin < 0:  # the last bytes may be the start of one
                begin = max(end - len(protocol.header) + 1, start)
            start = begin
            if end - start < protocol.head:
                break
            size = protocol.size(bytes(self._waiting[start : start + protocol.head]))
            if protocol.overhead <= size <= self._longest:
                if start + size > end:
                    break
                packet = protocol.packet(bytes(self._waiting[start : start + size]))
                if packet is not None:
                    packets.append(packet)
                    start += size
                    continue
            self.garbled += 1
            start += 1
        del self._waiting[:start]
        return packets

    def clear(self) -> None:
        """Discard an incomplete packet."""
        self._waiting.clear()
