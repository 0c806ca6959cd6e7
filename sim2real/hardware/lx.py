"""The protocol of LX bus servos (LX-16A, LX-224, LX-824): packets to bytes, replies to numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from sim2real.hardware.frames import FrameDecoder

HEADER = b"\x55\x55"
BROADCAST = 254
LARGEST_ID = 253
SHORTEST, LONGEST = 3, 7  # values of LEN in this family
TICK_RAD = math.radians(0.24)
CENTRE_TICKS, LARGEST_TICKS = 500, 1000
LONGEST_MOVE_MS = 30_000
BAUD_RATES = (115_200, 9600)  # servos sometimes fall back to the second


class BusCommand(IntEnum):
    """All commands of the family except 13, which changes the identity of a servo permanently."""

    MOVE_TIME_WRITE = 1
    MOVE_TIME_READ = 2
    MOVE_TIME_WAIT_WRITE = 7
    MOVE_TIME_WAIT_READ = 8
    MOVE_START = 11
    MOVE_STOP = 12
    ID_READ = 14
    ANGLE_OFFSET_ADJUST = 17
    ANGLE_OFFSET_WRITE = 18
    ANGLE_OFFSET_READ = 19
    ANGLE_LIMIT_WRITE = 20
    ANGLE_LIMIT_READ = 21
    VIN_LIMIT_WRITE = 22
    VIN_LIMIT_READ = 23
    TEMP_MAX_LIMIT_WRITE = 24
    TEMP_MAX_LIMIT_READ = 25
    TEMP_READ = 26
    VIN_READ = 27
    POS_READ = 28
    MOTOR_MODE_WRITE = 29
    MOTOR_MODE_READ = 30
    LOAD_WRITE = 31
    LOAD_READ = 32
    LED_CTRL_WRITE = 33
    LED_CTRL_READ = 34
    LED_ERROR_WRITE = 35
    LED_ERROR_READ = 36


REPLY_BYTES = {
    BusCommand.MOVE_TIME_READ: 4,
    BusCommand.MOVE_TIME_WAIT_READ: 4,
    BusCommand.ID_READ: 1,
    BusCommand.ANGLE_OFFSET_READ: 1,
    BusCommand.ANGLE_LIMIT_READ: 4,
    BusCommand.VIN_LIMIT_READ: 4,
    BusCommand.TEMP_MAX_LIMIT_READ: 1,
    BusCommand.TEMP_READ: 1,
    BusCommand.VIN_READ: 2,
    BusCommand.POS_READ: 2,
    BusCommand.MOTOR_MODE_READ: 4,
    BusCommand.LOAD_READ: 1,
    BusCommand.LED_CTRL_READ: 1,
    BusCommand.LED_ERROR_READ: 1,
}
"""Number of parameter bytes in the reply to each command that has a reply."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet: a command to a servo, or the reply, which has the same command number."""

    servo_id: int
    command: int
    parameters: bytes = b""


def checksum(body: bytes) -> int:
    """Complement of the sum of everything between header and checksum, in one byte."""
    return ~sum(body) & 0xFF


def encode(packet: Packet) -> bytes:
    """The packet as bytes.

    Raises:
        ValueError: If identity, command or number of parameters is not in the protocol.
    """
    if not 0 <= packet.servo_id <= BROADCAST:
        raise ValueError(f"servo {packet.servo_id}: identities run from 0 to {LARGEST_ID}")
    if packet.command not in BusCommand.__members__.values():
        raise ValueError(f"command {packet.command} is not supported")
    length = len(packet.parameters) + SHORTEST
    if length > LONGEST:
        raise ValueError(f"{len(packet.parameters)} bytes of parameters, at most 4 are possible")
    body = bytes((packet.servo_id, length, packet.command)) + packet.parameters
    return HEADER + body + bytes((checksum(body),))


def expects_reply(packet: Packet) -> bool:
    """Whether a servo replies to ``packet``."""
    return packet.command in REPLY_BYTES and not packet.parameters


def is_reply(request: Packet, packet: Packet) -> bool:
    """Whether ``packet`` is the reply to ``request``; an echo of the request is not."""
    return (
        packet.command == request.command
        and request.servo_id in (packet.servo_id, BROADCAST)
        and len(packet.parameters) == REPLY_BYTES[BusCommand(request.command)]
    )


def move(servo_id: int, ticks: int, time_ms: int = 0) -> Packet:
    """Move to ``ticks`` at constant speed in ``time_ms``; 0 for the largest speed.

    Raises:
        ValueError: If ticks or time are out of range.
    """
    if not 0 <= ticks <= LARGEST_TICKS or not 0 <= time_ms <= LONGEST_MOVE_MS:
        raise ValueError(f"{ticks} ticks in {time_ms} ms is outside 0 to 1000 in 0 to 30000")
    parameters = ticks.to_bytes(2, "little") + time_ms.to_bytes(2, "little")
    return Packet(servo_id, BusCommand.MOVE_TIME_WRITE, parameters)


def load(servo_id: int, on: bool) -> Packet:
    """Switch the torque on or off."""
    return Packet(servo_id, BusCommand.LOAD_WRITE, bytes((on,)))


def signed_word(reply: Packet) -> int:
    """First two bytes of the reply as a signed number, such as a position in ticks."""
    return int.from_bytes(reply.parameters[:2], "little", signed=True)


def words(reply: Packet) -> tuple[int, ...]:
    """Pairs of bytes of the reply as unsigned numbers, such as the ends of a range."""
    parameters = reply.parameters
    return tuple(
        int.from_bytes(parameters[k : k + 2], "little") for k in range(0, len(parameters), 2)
    )


def supply_V(reply: Packet) -> float:
    """Supply in V from a VIN_READ reply, which is in mV."""
    return words(reply)[0] / 1000


class Decoder(FrameDecoder[Packet]):
    """Decoder of this protocol."""

    header = HEADER
    head_bytes = 4
    largest = LONGEST + 3

    def size(self, head: bytes) -> int:
        """Bytes of the frame with these first bytes; 0 if there is no such frame."""
        size = head[3] + 3
        return size if SHORTEST + 3 <= size <= self._longest else 0

    def packet(self, frame: bytes) -> Packet | None:
        """The packet in a frame; None if its checksum does not agree."""
        body = frame[len(HEADER) : -1]
        return Packet(body[0], body[2], body[3:]) if checksum(body) == frame[-1] else None
