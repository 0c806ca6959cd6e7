"""Dynamixel servos of Protocol 2.0 (X and MX series) behind the interface of the buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from sim2real.hardware import dynamixel
from sim2real.hardware.dynamixel import (
    ALERT,
    BROADCAST,
    DynamixelDecoder,
    DynamixelInstruction,
    DynamixelPacket,
    encode,
)
from sim2real.hardware.register_bus import RegisterBus

LONGEST_STATUS = 128


class DynamixelBus(RegisterBus[DynamixelPacket]):
    """A bus of Dynamixel servos."""

    name: ClassVar[str] = "dynamixel"
    baud_rates: ClassVar[tuple[int, ...]] = (1_000_000, 57_600, 115_200, 2_000_000, 3_000_000)
    largest_id: ClassVar[int] = dynamixel.LARGEST_ID

    def _decoder(self) -> DynamixelDecoder:
        return DynamixelDecoder(LONGEST_STATUS)

    def _read(self, servo_id: int, address: int, count: int) -> bytes:
        return _instruction(servo_id, DynamixelInstruction.READ, _words(address, count))

    def _write(self, servo_id: int, address: int, data: bytes) -> bytes:
        return _instruction(servo_id, DynamixelInstruction.WRITE, _words(address) + data)

    def _sync_read(self, ids: Sequence[int], address: int, count: int) -> bytes:
        parameters = _words(address, count) + bytes(ids)
        return _instruction(BROADCAST, DynamixelInstruction.SYNC_READ, parameters)

    def _sync_write(self, address: int, data: Mapping[int, bytes]) -> bytes:
        count = len(next(iter(data.values())))
        blocks = b"".join(bytes((servo_id,)) + block for servo_id, block in data.items())
        parameters = _words(address, count) + blocks
        return _instruction(BROADCAST, DynamixelInstruction.SYNC_WRITE, parameters)

    def _data(self, packet: DynamixelPacket, servo_id: int) -> bytes | None:
        status = packet.instruction == DynamixelInstruction.STATUS and packet.parameters
        if not status or packet.servo_id != servo_id or packet.parameters[0] & ~ALERT:
            return None
        return packet.parameters[1:]

    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        ping = _instruction(servo_id, DynamixelInstruction.PING, b"")
        data = self._exchange(ping, servo_id, 3, within_s)
        return None if data is None else int.from_bytes(data[:2], "little")

    def _status_bytes(self, count: int) -> int:
        return count + 11


def _instruction(servo_id: int, instruction: int, parameters: bytes) -> bytes:
    return encode(DynamixelPacket(servo_id, instruction, parameters))


def _words(*numbers: int) -> bytes:
    return b"".join(number.to_bytes(2, "little") for number in numbers)
