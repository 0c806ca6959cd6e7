"""A virtual LX servo: replies to packets, and motion of the shaft."""

from __future__ import annotations

from sim2real.hardware.frames import BROADCAST, Packet
from sim2real.hardware.lx import SCALE, LxCommand, expects_reply
from sim2real.hardware.virtual_bus import VirtualServo

_FIXED = {
    LxCommand.VIN_LIMIT_READ: bytes((0x94, 0x11, 0xE0, 0x2E)),  # 4500 to 12000 mV
    LxCommand.TEMP_MAX_LIMIT_READ: bytes((85,)),
}


class VirtualLx(VirtualServo):
    """One LX servo, with the commands of ``LxCommand``."""

    _limits = bytes((0, 0, 0xE8, 0x03))  # 0 to 1000 ticks

    def ticks(self, now: float) -> int:
        """Reported position in ticks of 0.24 degrees."""
        return SCALE.centre_ticks + round(self._shaft.angle(now) / SCALE.tick_rad)

    def handle(self, packet: Packet, now: float) -> Packet | None:
        """Process a packet; the reply, if it is a request to this servo."""
        everyone = packet.servo_id == BROADCAST
        if not self.connected or not (everyone or packet.servo_id == self.servo_id):
            return None
        if not expects_reply(packet):
            self._obey(packet.code, packet.parameters, now)
        elif not everyone or packet.code == LxCommand.ID_READ:
            return Packet(self.servo_id, packet.code, self._answer(packet.code, now))
        return None

    def _answer(self, command: int, now: float) -> bytes:
        if command == LxCommand.POS_READ:
            return max(min(self.ticks(now), 32767), -32768).to_bytes(2, "little", signed=True)
        if command == LxCommand.VIN_READ:
            return round(1000 * self._supply_V).to_bytes(2, "little")
        if command == LxCommand.TEMP_READ:
            return bytes((self._degrees(now),))
        if command == LxCommand.LOAD_READ:
            return bytes((self.powered,))
        if command == LxCommand.ID_READ:
            return bytes((self.servo_id,))
        return self._limits if command == LxCommand.ANGLE_LIMIT_READ else _FIXED[LxCommand(command)]

    def _obey(self, command: int, parameters: bytes, now: float) -> None:
        if command == LxCommand.MOVE_TIME_WRITE and len(parameters) == 4:
            (low, high), (ticks, milliseconds) = _words(self._limits), _words(parameters)
            self._shaft.angle(now)
            angle = SCALE.angle(min(max(ticks, low), high))
            self._shaft.command(now, angle, milliseconds / 1000)
        elif command == LxCommand.MOVE_STOP:
            self._shaft.hold(now)
        elif command == LxCommand.LOAD_WRITE and len(parameters) == 1:
            self._power(parameters[0] != 0, now)
        elif command == LxCommand.ANGLE_LIMIT_WRITE and len(parameters) == 4:
            self._limits = parameters


def _words(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:], "little")
