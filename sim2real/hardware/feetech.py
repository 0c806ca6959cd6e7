"""Protocol of Feetech's STS, SMS and SCS servos: packets to bytes and back.

A frame is ``FF FF``, identity, length, instruction, parameters, checksum; the length counts
instruction, parameters and checksum. A status packet has an error byte in place of the instruction.
Numbers have the low byte first in STS and SMS servos, and the high byte first in SCS servos; the
frame itself is the same (Feetech, *Serial bus servo communication protocol manual*).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from sim2real.hardware.frames import FrameDecoder

HEADER = b"\xff\xff"
BROADCAST = 254
LARGEST_ID = 253
LONGEST = 256
_FIXED = 4  # bytes that the length does not count
_SHORTEST = 2


class FeetechInstruction(IntEnum):
    """Instructions that are used here; sync read is not available in SCS servos."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


@dataclass(frozen=True, slots=True)
class FeetechPacket:
    """An instruction to a servo, or its status packet, whose ``code`` is the error byte."""

    servo_id: int
    code: int
    parameters: bytes = b""


def checksum(body: bytes) -> int:
    """Complement of the sum of everything between header and checksum, in one byte."""
    return ~sum(body) & 0xFF


def encode(packet: FeetechPacket) -> bytes:
    """The packet as bytes.

    Raises:
        ValueError: If identity or number of parameters is not in the protocol.
    """
    if not 0 <= packet.servo_id <= BROADCAST:
        raise ValueError(f"servo {packet.servo_id}: identities run from 0 to {LARGEST_ID}")
    length = len(packet.parameters) + _SHORTEST
    if length > LONGEST - _FIXED:
        raise ValueError(f"{len(packet.parameters)} bytes of parameters are too many")
    body = bytes((packet.servo_id, length, packet.code)) + packet.parameters
    return HEADER + body + bytes((checksum(body),))


class FeetechDecoder(FrameDecoder[FeetechPacket]):
    """Decoder of this protocol."""

    header = HEADER
    head_bytes = _FIXED
    largest = LONGEST

    def size(self, head: bytes) -> int:
        """Bytes of the frame with these first bytes; 0 if there is no such frame."""
        size = head[3] + _FIXED
        return size if head[2] != 0xFF and _FIXED + _SHORTEST <= size <= self._longest else 0

    def packet(self, frame: bytes) -> FeetechPacket | None:
        """The packet in a frame; None if its checksum does not agree."""
        body = frame[len(HEADER) : -1]
        if checksum(body) != frame[-1]:
            return None
        return FeetechPacket(body[0], body[2], body[3:])
