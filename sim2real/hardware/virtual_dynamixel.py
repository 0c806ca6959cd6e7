"""A virtual Dynamixel servo: Protocol 2.0 over its registers."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.hardware.dynamixel import (
    ALERT,
    BROADCAST,
    DynamixelDecoder,
    DynamixelError,
    DynamixelInstruction,
    DynamixelPacket,
    encode,
)
from sim2real.hardware.servo_models import ServoModel
from sim2real.hardware.virtual_bus import Speech
from sim2real.hardware.virtual_registers import Refusal, RegisterServo
from sim2real.hardware.virtual_shaft import Law

BAUD_CODES = {
    9600: 0,
    57_600: 1,
    115_200: 2,
    1_000_000: 3,
    2_000_000: 4,
    3_000_000: 5,
    4_000_000: 6,
}
_FACTORY = {
    "firmware": 46,
    "return_delay": 250,
    "operating_mode": 3,
    "max_temperature": 70,
    "max_voltage": 140,
    "min_voltage": 35,
    "max_position": 4095,
    "status_level": 2,
    "position_p": 400,
    "goal_pwm": 885,
}
_ERRORS: dict[Refusal, DynamixelError] = {
    "range": DynamixelError.RANGE,
    "access": DynamixelError.ACCESS,
    "length": DynamixelError.LENGTH,
}


def dynamixel_servo(
    servo_id: int, model: ServoModel, law: Law, now: float, *, baud: int = 1_000_000, **more: float
) -> VirtualDynamixel:
    """A servo as it leaves the factory, except for identity and rate.

    Args:
        servo_id: Identity.
        model: Its model.
        law: Law of its shaft.
        now: Present time in s.
        baud: Bits per second.
        **more: Other arguments of ``RegisterServo``.
    """
    assert model.number is not None
    values = {**_FACTORY, "model": model.number, "baud": BAUD_CODES.get(baud, 3)}
    return VirtualDynamixel(servo_id, model, values, law, now, **more)


class VirtualDynamixel(RegisterServo):
    """One Dynamixel servo."""

    def handle(self, packet: DynamixelPacket, now: float) -> DynamixelPacket | None:
        """Process a packet; the status packet, if there is one."""
        if not self.connected or packet.instruction == DynamixelInstruction.STATUS:
            return None
        self.heard(now)
        everyone = packet.servo_id == BROADCAST
        if not everyone and packet.servo_id != self.servo_id:
            return None
        instruction, data = packet.instruction, packet.parameters
        if instruction == DynamixelInstruction.PING:
            return self._status(0, self.memory[0:2] + self.memory[6:7])
        if instruction == DynamixelInstruction.SYNC_READ and everyone:
            return self._sync_read(data, now)
        if instruction == DynamixelInstruction.SYNC_WRITE and everyone:
            self.write_own(_word(data), _word(data[2:]), data[4:], now)
        elif instruction == DynamixelInstruction.READ and not everyone:
            return self._read_reply(data, now)
        elif instruction == DynamixelInstruction.WRITE:
            refused = self.write(_word(data), data[2:], now)
            if not everyone and self.get("status_level") == 2:
                return self._status(0 if refused is None else _ERRORS[refused])
        elif not everyone:
            return self._status(DynamixelError.INSTRUCTION)
        return None

    def _sync_read(self, data: bytes, now: float) -> DynamixelPacket | None:
        return self._read_reply(data[:4], now) if self.servo_id in data[4:] else None

    def _read_reply(self, data: bytes, now: float) -> DynamixelPacket | None:
        if self.get("status_level") == 0:
            return None
        if len(data) != 4:
            return self._status(DynamixelError.LENGTH)
        found = self.read(_word(data), _word(data[2:]), now)
        return self._status(DynamixelError.RANGE) if found is None else self._status(0, found)

    def _status(self, error: int, data: bytes | bytearray = b"") -> DynamixelPacket:
        alert = ALERT if self.get("errors") else 0
        parameters = bytes((error | alert,)) + bytes(data)
        return DynamixelPacket(self.servo_id, DynamixelInstruction.STATUS, parameters)


def _order(packet: DynamixelPacket) -> Sequence[int]:
    if packet.instruction == DynamixelInstruction.SYNC_READ:
        return list(packet.parameters[4:])
    return ()


def _word(data: bytes) -> int:
    return int.from_bytes(data[:2], "little")


DYNAMIXEL = Speech(DynamixelDecoder, encode, 10, _order)
