"""Dynamixel Protocol 2.0: packets to bytes and back.

A frame is ``FF FF FD 00``, identity, length (two bytes), instruction, parameters, CRC-16 (two
bytes); numbers have the low byte first. Where the body contains ``FF FF FD``, a byte ``FD`` is
inserted after it, so that no header occurs inside a frame. A status packet is a frame with
instruction 55 (hexadecimal) whose first parameter is an error number
(https://emanual.robotis.com/docs/en/dxl/protocol2/).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from sim2real.hardware.frames import FrameDecoder

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 254
LARGEST_ID = 252
ALERT = 0x80
"""Bit of the error number: the register of hardware errors is not 0."""
_STUFFED, _STUFFING = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_FIXED = 7  # bytes before the instruction
_CRC_BYTES = 2
LONGEST = 1024


class DynamixelInstruction(IntEnum):
    """Instructions of Protocol 2.0 that are used here."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class DynamixelError(IntEnum):
    """Error numbers of a status packet."""

    INSTRUCTION = 2
    RANGE = 4
    LENGTH = 5
    ACCESS = 7


@dataclass(frozen=True, slots=True)
class DynamixelPacket:
    """An instruction to a servo, or its status packet."""

    servo_id: int
    instruction: int
    parameters: bytes = b""


def crc16(data: bytes) -> int:
    """CRC-16 with polynomial 8005 (hexadecimal), starting at 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def _entry(index: int) -> int:
    crc = index << 8
    for _ in range(8):
        crc = crc << 1 ^ (0x8005 if crc & 0x8000 else 0)
    return crc & 0xFFFF


_TABLE = tuple(_entry(index) for index in range(256))


def encode(packet: DynamixelPacket) -> bytes:
    """The packet as bytes.

    Raises:
        ValueError: If the identity is not in the protocol.
    """
    if not 0 <= packet.servo_id <= BROADCAST or packet.servo_id == LARGEST_ID + 1:
        raise ValueError(f"servo {packet.servo_id}: identities run from 0 to {LARGEST_ID}")
    body = bytes((packet.instruction,)) + packet.parameters
    body = body.replace(_STUFFED, _STUFFING)
    length = len(body) + _CRC_BYTES
    frame = HEADER + bytes((packet.servo_id,)) + length.to_bytes(2, "little") + body
    return frame + crc16(frame).to_bytes(_CRC_BYTES, "little")


class DynamixelDecoder(FrameDecoder[DynamixelPacket]):
    """Decoder of Protocol 2.0."""

    header = HEADER
    head_bytes = _FIXED
    largest = LONGEST

    def size(self, head: bytes) -> int:
        """Bytes of the frame with these first bytes; 0 if there is no such frame."""
        size = int.from_bytes(head[5:7], "little") + _FIXED
        return size if head[4] != 0xFF and _FIXED + 3 <= size <= self._longest else 0

    def packet(self, frame: bytes) -> DynamixelPacket | None:
        """The packet in a frame; None if its CRC does not agree."""
        if crc16(frame[:-_CRC_BYTES]) != int.from_bytes(frame[-_CRC_BYTES:], "little"):
            return None
        body = frame[_FIXED:-_CRC_BYTES].replace(_STUFFING, _STUFFED)
        return DynamixelPacket(frame[4], body[0], body[1:]) if body else None
