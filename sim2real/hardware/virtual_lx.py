"""A virtual LX servo: replies to packets, and motion of the shaft."""

from __future__ import annotations

from sim2real.hardware.lx import (
    BROADCAST,
    CENTRE_TICKS,
    REPLY_BYTES,
    TICK_RAD,
    BusCommand,
    Decoder,
    Packet,
    encode,
    expects_reply,
    words,
)
from sim2real.hardware.virtual_bus import Speech
from sim2real.hardware.virtual_shaft import Law, Shaft

_REGISTERS = {
    BusCommand.ANGLE_OFFSET_READ: bytes(1),
    BusCommand.ANGLE_LIMIT_READ: bytes((0, 0, 0xE8, 0x03)),  # 0 to 1000 ticks
    BusCommand.VIN_LIMIT_READ: bytes((0x94, 0x11, 0xE0, 0x2E)),  # 4500 to 12000 mV
    BusCommand.TEMP_MAX_LIMIT_READ: bytes((85,)),
    BusCommand.MOTOR_MODE_READ: bytes(4),
    BusCommand.LED_CTRL_READ: bytes(1),
    BusCommand.LED_ERROR_READ: bytes((7,)),
}
_WRITES = {
    BusCommand.ANGLE_OFFSET_ADJUST: BusCommand.ANGLE_OFFSET_READ,
    BusCommand.ANGLE_LIMIT_WRITE: BusCommand.ANGLE_LIMIT_READ,
    BusCommand.VIN_LIMIT_WRITE: BusCommand.VIN_LIMIT_READ,
    BusCommand.TEMP_MAX_LIMIT_WRITE: BusCommand.TEMP_MAX_LIMIT_READ,
    BusCommand.LED_CTRL_WRITE: BusCommand.LED_CTRL_READ,
    BusCommand.LED_ERROR_WRITE: BusCommand.LED_ERROR_READ,
}
_MOVES = (BusCommand.MOVE_TIME_WRITE, BusCommand.MOVE_TIME_WAIT_WRITE)


class VirtualServo:
    """One servo on a virtual bus, initially at rest at angle 0 with its torque off.

    Args:
        servo_id: Identity.
        law: Law of its shaft.
        now: Present time in s; later calls use the same clock.
        supply_V: Supply voltage.
        temperature_C: Initial temperature.
        heating_C_per_s: Rate of change of the temperature.

    Attributes:
        connected: False for a disconnected servo, which receives and sends nothing.
        powered: Whether its torque is on.
        delay_s: Time between the end of a request and the reply.
    """

    delay_s = 0.0

    def __init__(
        self,
        servo_id: int,
        law: Law,
        now: float,
        *,
        supply_V: float = 7.4,
        temperature_C: float = 30.0,
        heating_C_per_s: float = 0.0,
    ) -> None:
        self.servo_id = servo_id
        self.connected = True
        self._shaft = Shaft(law, now)
        self._born = now
        self._supply_V = supply_V
        self._temperature_C, self._heating = temperature_C, heating_C_per_s
        self._registers = dict(_REGISTERS)
        self._moves = {command: b"\xf4\x01\x00\x00" for command in _MOVES}
        self._waiting = False

    @property
    def powered(self) -> bool:
        """Whether its torque is on."""
        return self._shaft.powered

    def advance(self, now: float) -> None:
        """Advance the simulation to ``now``."""
        self._shaft.angle(now)

    def ticks(self, now: float) -> int:
        """Reported position in ticks of 0.24 degrees."""
        return CENTRE_TICKS + round(self._shaft.angle(now) / TICK_RAD)

    def handle(self, packet: Packet, now: float) -> Packet | None:
        """Process a packet; the reply, if it is a request to this servo."""
        if not self.connected or packet.servo_id not in (self.servo_id, BROADCAST):
            return None
        if expects_reply(packet):
            if packet.servo_id == BROADCAST and packet.command != BusCommand.ID_READ:
                return None
            return Packet(self.servo_id, packet.command, self._answer(packet.command, now))
        self._obey(packet, now)
        return None

    def _answer(self, command: int, now: float) -> bytes:
        if command == BusCommand.POS_READ:
            number = self.ticks(now)
            return max(min(number, 32767), -32768).to_bytes(2, "little", signed=True)
        if command == BusCommand.VIN_READ:
            return round(1000 * self._supply_V).to_bytes(2, "little")
        if command == BusCommand.TEMP_READ:
            temperature = self._temperature_C + self._heating * (now - self._born)
            return bytes((min(max(round(temperature), 0), 255),))
        if command == BusCommand.LOAD_READ:
            return bytes((self.powered,))
        if command == BusCommand.ID_READ:
            return bytes((self.servo_id,))
        if command in (BusCommand.MOVE_TIME_READ, BusCommand.MOVE_TIME_WAIT_READ):
            return self._moves[BusCommand(command - 1)]
        return self._registers[BusCommand(command)]

    def _obey(self, packet: Packet, now: float) -> None:
        command, parameters = packet.command, packet.parameters
        if command in _MOVES and len(parameters) == 4:
            self._moves[BusCommand(command)] = parameters
            self._waiting = command == BusCommand.MOVE_TIME_WAIT_WRITE
            if not self._waiting:
                self._move(parameters, now)
        elif command == BusCommand.MOVE_START and self._waiting:
            self._waiting = False
            self._move(self._moves[BusCommand.MOVE_TIME_WAIT_WRITE], now)
        elif command == BusCommand.MOVE_STOP:
            self._shaft.hold(now)
        elif command == BusCommand.LOAD_WRITE and len(parameters) == 1:
            self._shaft.hold(now)
            self._shaft.powered = parameters[0] != 0
        elif command in _WRITES and len(parameters) == REPLY_BYTES[_WRITES[BusCommand(command)]]:
            self._registers[_WRITES[BusCommand(command)]] = parameters

    def _move(self, parameters: bytes, now: float) -> None:
        limits = self._registers[BusCommand.ANGLE_LIMIT_READ]
        low, high = words(Packet(self.servo_id, BusCommand.ANGLE_LIMIT_READ, limits))
        ticks = min(max(int.from_bytes(parameters[:2], "little"), low), high)
        duration = int.from_bytes(parameters[2:], "little") / 1000
        self._shaft.angle(now)
        self._shaft.command(now, (ticks - CENTRE_TICKS) * TICK_RAD, duration)


LX = Speech(Decoder, encode, 6)
