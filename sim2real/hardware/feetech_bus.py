"""Feetech servos (STS, SMS and SCS series) behind the interface of the buses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from sim2real.hardware import feetech
from sim2real.hardware.feetech import (
    BROADCAST,
    FeetechDecoder,
    FeetechInstruction,
    FeetechPacket,
    encode,
)
from sim2real.hardware.register_bus import RegisterBus
from sim2real.hardware.registers import LAYOUTS

LONGEST_STATUS = 64
SCS_MAIN_VERSION = 5
"""First byte of the model's number in servos that have the high byte of a number first."""


class FeetechBus(RegisterBus[FeetechPacket]):
    """A bus of Feetech servos, which may be of different series."""

    name: ClassVar[str] = "feetech"
    baud_rates: ClassVar[tuple[int, ...]] = (1_000_000, 500_000, 115_200)
    largest_id: ClassVar[int] = feetech.LARGEST_ID

    def _decoder(self) -> FeetechDecoder:
        return FeetechDecoder(LONGEST_STATUS)

    def _read(self, servo_id: int, address: int, count: int) -> bytes:
        return _instruction(servo_id, FeetechInstruction.READ, bytes((address, count)))

    def _write(self, servo_id: int, address: int, data: bytes) -> bytes:
        return _instruction(servo_id, FeetechInstruction.WRITE, bytes((address,)) + data)

    def _sync_read(self, ids: Sequence[int], address: int, count: int) -> bytes:
        parameters = bytes((address, count, *ids))
        return _instruction(BROADCAST, FeetechInstruction.SYNC_READ, parameters)

    def _sync_write(self, address: int, data: Mapping[int, bytes]) -> bytes:
        count = len(next(iter(data.values())))
        blocks = b"".join(bytes((servo_id,)) + block for servo_id, block in data.items())
        parameters = bytes((address, count)) + blocks
        return _instruction(BROADCAST, FeetechInstruction.SYNC_WRITE, parameters)

    def _data(self, packet: FeetechPacket, servo_id: int) -> bytes | None:
        # the error byte tells the servo's state (voltage, load, ...); the data are valid
        return packet.parameters if packet.servo_id == servo_id else None

    def _ask_number(self, servo_id: int, within_s: float) -> int | None:
        register = LAYOUTS["sts"]["model"]  # at the same address in all series
        data = self.ask(servo_id, register.address, register.size, within_s)
        if data is None:
            return None
        return int.from_bytes(data, "big" if data[0] == SCS_MAIN_VERSION else "little")

    def _status_bytes(self, count: int) -> int:
        return count + 6


def _instruction(servo_id: int, instruction: int, parameters: bytes) -> bytes:
    return encode(FeetechPacket(servo_id, instruction, parameters))
