"""A virtual Feetech servo (STS, SMS or SCS): the protocol over its registers."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.hardware.feetech import (
    BROADCAST,
    FeetechDecoder,
    FeetechInstruction,
    FeetechPacket,
    encode,
)
from sim2real.hardware.servo_models import ServoModel
from sim2real.hardware.virtual_bus import Speech
from sim2real.hardware.virtual_registers import RegisterServo
from sim2real.hardware.virtual_shaft import Law

BAUD_CODES = {
    1_000_000: 0, 500_000: 1, 250_000: 2, 128_000: 3, 115_200: 4, 76_800: 5, 57_600: 6, 38_400: 7,
}  # fmt: skip
_FACTORY = {
    "status_level": 1,
    "max_temperature": 70,
    "max_voltage": 140,
    "min_voltage": 40,
    "max_torque": 1000,
    "position_p": 32,
    "position_d": 32,
    "torque_limit": 1000,
}


def feetech_servo(
    servo_id: int, model: ServoModel, law: Law, now: float, *, baud: int = 1_000_000, **more: float
) -> VirtualFeetech:
    """A servo as it leaves the factory, except for identity and rate.

    Args:
        servo_id: Identity.
        model: Its model.
        law: Law of its shaft.
        now: Present time in s.
        baud: Bits per second.
        **more: Other arguments of ``RegisterServo``.
    """
    number = model.number or model.main_version
    assert number is not None
    largest = 2 * model.centre_ticks - 1
    values = {"model": number, "baud": BAUD_CODES.get(baud, 0), "max_position": largest}
    return VirtualFeetech(servo_id, model, {**_FACTORY, **values}, law, now, **more)


class VirtualFeetech(RegisterServo):
    """One Feetech servo."""

    def handle(self, packet: FeetechPacket, now: float) -> FeetechPacket | None:
        """Process a packet; the status packet, if there is one."""
        if not self.connected:
            return None
        self.heard(now)
        everyone = packet.servo_id == BROADCAST
        if not everyone and packet.servo_id != self.servo_id:
            return None
        instruction, data = packet.code, packet.parameters
        if instruction == FeetechInstruction.PING:
            return self._status()
        if instruction == FeetechInstruction.SYNC_READ and everyone:
            listed = self._layout.sync_read and self.servo_id in data[2:]
            return self._read_reply(data[:2], now) if listed else None
        if instruction == FeetechInstruction.SYNC_WRITE and everyone:
            if len(data) > 1:
                self.write_own(data[0], data[1], data[2:], now)
        elif instruction == FeetechInstruction.READ and not everyone:
            return self._read_reply(data, now)
        elif instruction == FeetechInstruction.WRITE and data:
            self.write(data[0], data[1:], now)
            if not everyone and self.get("status_level") == 1:
                return self._status()
        return None

    def _read_reply(self, data: bytes, now: float) -> FeetechPacket | None:
        found = self.read(data[0], data[1], now) if len(data) == 2 else None
        return None if found is None else self._status(found)

    def _status(self, data: bytes = b"") -> FeetechPacket:
        return FeetechPacket(self.servo_id, self.get("errors"), data)


def _order(packet: FeetechPacket) -> Sequence[int]:
    if packet.servo_id == BROADCAST and packet.code == FeetechInstruction.SYNC_READ:
        return list(packet.parameters[2:])
    return ()


FEETECH = Speech(FeetechDecoder, encode, 6, _order)
