"""Virtual servos: LX, and those that are controlled by registers, Dynamixel and Feetech."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Literal

from sim2real.hardware.frames import BROADCAST, Instruction, Packet
from sim2real.hardware.lx import SERVO, LxCommand, expects_reply
from sim2real.hardware.register_bus import ALERT
from sim2real.hardware.registers import TORQUE, ServoModel
from sim2real.hardware.virtual_bus import Law, VirtualServo

Refusal = Literal["instruction", "range", "length", "access"]
WATCHDOG_UNIT_S = 0.02
DELAY_UNIT_S = 2e-6
_STALL_A = 1.0
"""Current at the stall torque."""


class VirtualLx(VirtualServo):
    """One LX servo, with the commands of ``LxCommand``; the time of a move is ignored."""

    def ticks(self, now: float) -> int:
        """Reported position in ticks of 0.24 degrees."""
        return SERVO.centre_ticks + round(self.angle(now) / SERVO.tick_rad)

    def handle(self, packet: Packet, now: float) -> Packet | None:
        """Process a packet; the reply, if it is a request to this servo."""
        everyone = packet.servo_id == BROADCAST
        if not self.connected or not (everyone or packet.servo_id == self.servo_id):
            return None
        command, parameters = packet.code, packet.parameters
        if command == LxCommand.MOVE_TIME_WRITE and len(parameters) == 4:
            ticks = int.from_bytes(parameters[:2], "little")
            self.command(now, SERVO.angle(min(ticks, SERVO.largest_ticks)))
        elif command == LxCommand.MOVE_STOP:
            self.hold(now)
        elif command == LxCommand.LOAD_WRITE and len(parameters) == 1:
            self.power(parameters[0] != 0, now)
        elif expects_reply(packet) and (not everyone or command == LxCommand.ID_READ):
            ticks = max(min(self.ticks(now), 32767), -32768)
            answers = {
                LxCommand.POS_READ: ticks.to_bytes(2, "little", signed=True),
                LxCommand.VIN_READ: round(1000 * self._supply_V).to_bytes(2, "little"),
                LxCommand.TEMP_READ: bytes((self._degrees(now),)),
                LxCommand.LOAD_READ: bytes((self.powered,)),
                LxCommand.ID_READ: bytes((self.servo_id,)),
                LxCommand.VIN_LIMIT_READ: bytes((0x94, 0x11, 0xE0, 0x2E)),  # 4500 to 12000 mV
                LxCommand.TEMP_MAX_LIMIT_READ: bytes((85,)),
            }
            return Packet(self.servo_id, command, answers[LxCommand(command)])
        return None


class RegisterServo(VirtualServo):
    """One servo as it leaves the factory, except for its identity, and a rate of 1 Mbaud.

    Motion profiles are stored only. The current or load is the torque as a share of the stall
    torque.
    """

    word_bytes: ClassVar[int]  # bytes of an address, and of a number of bytes, in an instruction
    # value of the register ``status_level`` with which writes are answered
    answers_writes: ClassVar[int]
    refuses: ClassVar[bool]  # whether it answers what cannot be read or is no instruction
    pinged: ClassVar[tuple[str, ...]]  # registers in the answer to a ping
    factory: ClassVar[Mapping[str, int]]  # values of registers

    def __init__(
        self, model: ServoModel, servo_id: int, law: Law, now: float, **more: float
    ) -> None:
        super().__init__(servo_id, law, now, **more)
        self.model, self.memory = model, bytearray(256)
        self._layout, self._scale = model.layout, model.servo(servo_id)
        self._heard = now
        rating = model.rating(self._supply_V)
        self._stall_Nm = law.kp_Nm_per_rad if rating is None else rating.stall_torque_Nm
        start = {
            "max_position": 2 * model.centre_ticks - 1,
            "model": model.number or model.main_version or 0,
            "goal_position": model.centre_ticks,
            "servo_id": servo_id,
        }
        for name, value in {**self.factory, **start}.items():
            self.put(name, value)
        self.delay_s = self.get("return_delay") * DELAY_UNIT_S
        self._refresh(now)

    @abstractmethod
    def _status(self, refused: Refusal | None, data: bytes = b"") -> Packet:
        """The answer, with the reason if it is a refusal."""

    def _refusal(self, reason: Refusal) -> Packet | None:
        """The answer to what cannot be read or is no instruction, if there is one."""
        return self._status(reason) if self.refuses else None

    def get(self, name: str) -> int:
        """Value of a register."""
        register = self._layout[name]
        return register.decode(bytes(self.memory[register.address : register.end]))

    def put(self, name: str, value: int) -> None:
        """Set a register without any effect, for example when the servo is made."""
        register = self._layout[name]
        self.memory[register.address : register.end] = register.encode(value)

    def advance(self, now: float) -> None:
        """Advance the simulation to ``now``; an expired watchdog stops the shaft."""
        super().advance(now)
        limit = self._watchdog() * WATCHDOG_UNIT_S if self.powered else 0
        if limit > 0 and now - self._heard > limit:
            self.hold(now)
            self.put("bus_watchdog", -1)

    def handle(self, packet: Packet, now: float) -> Packet | None:
        """Process a packet; the status packet, if there is one."""
        if not self.connected or packet.code == Instruction.STATUS:
            return None
        self.advance(now)
        self._heard = now
        everyone = packet.servo_id == BROADCAST
        if not everyone and packet.servo_id != self.servo_id:
            return None
        code, size = packet.code, self.word_bytes
        address, count = (
            int.from_bytes(packet.parameters[k : k + size], "little") for k in (0, size)
        )
        rest = packet.parameters[2 * size :]
        if code == Instruction.PING:
            told = [self._layout[name].encode(self.get(name)) for name in self.pinged]
            return self._status(None, b"".join(told))
        if code == Instruction.SYNC_READ and everyone:
            return self._read(address, count, now) if self.servo_id in rest else None
        if code == Instruction.SYNC_WRITE and everyone:
            for start in range(0, len(rest) - count, count + 1):  # an identity and its bytes
                if rest[start] == self.servo_id:
                    self.write(address, rest[start + 1 : start + 1 + count], now)
        elif code == Instruction.READ and not everyone:
            complete = len(packet.parameters) == 2 * size
            return self._read(address, count, now) if complete else self._refusal("length")
        elif code == Instruction.WRITE:
            refused = self.write(address, packet.parameters[size:], now)
            if not everyone and self.get("status_level") == self.answers_writes:
                return self._status(refused)
        elif not everyone:
            return self._refusal("instruction")
        return None

    def write(self, address: int, data: bytes, now: float) -> Refusal | None:
        """Write to the memory, with all effects; the reason if it is refused."""
        end = address + len(data)
        if not data or end > len(self.memory):
            return "length"
        registers = self._layout.registers.items()
        names = [name for name, r in registers if address <= r.address and r.end <= end]
        if any(name.startswith("present") or name in ("model", "firmware") for name in names):
            return "access"
        if address < self._layout.volatile_from and self.powered:
            return "access"
        before = bytes(self.memory)
        self.memory[address:end] = data
        if not all(self._allowed(name) for name in names):
            self.memory[:] = before
            return "range"
        for name in names:
            value = self.get(name)
            if name == TORQUE:
                self.power(value == 1, now)
            elif name == "goal_position" and self.powered:
                self.command(now, self._scale.angle(value))
            elif name == "servo_id":
                self.servo_id = value
        return None

    def _read(self, address: int, count: int, now: float) -> Packet | None:
        if not 0 < count <= len(self.memory) - address:
            return self._refusal("range")
        self._refresh(now)
        return self._status(None, bytes(self.memory[address : address + count]))

    def _watchdog(self) -> int:
        return self.get("bus_watchdog") if "bus_watchdog" in self._layout.registers else 0

    def _allowed(self, name: str) -> bool:
        value = self.get(name)
        if name == TORQUE:
            return value in (0, 1)
        if name == "bus_watchdog":
            return value >= 0
        if name == "goal_position":
            low, high = self.get("min_position"), self.get("max_position")
            return self._watchdog() >= 0 and (low <= value <= high or low == high)
        return True

    def _refresh(self, now: float) -> None:
        """Write the present values into the memory."""
        angle = self.angle(now)
        share = max(min(self.drive_Nm / self._stall_Nm, 1.0), -1.0)
        present = {
            "present_position": self._scale.centre_ticks + round(angle / self._scale.tick_rad),
            "present_velocity": round(self.speed / self.model.velocity_unit_rad_s),
            "present_load": round(1000 * share),
            "present_voltage": round(10 * self._supply_V),
            "present_temperature": self._degrees(now),
        }
        if self.model.current_unit_A is not None:
            apart = "present_current" in self._layout.registers
            name = "present_current" if apart else "present_load"
            present[name] = round(share * _STALL_A / self.model.current_unit_A)
        bits = {what: bit for bit, what in self._layout.errors.items()}
        hot = present["present_temperature"] > self.get("max_temperature")
        low, high = self.get("min_voltage"), self.get("max_voltage")
        voltage = not low <= present["present_voltage"] <= high
        present["errors"] = hot << bits["temperature"] | voltage << bits["voltage"]
        for name, value in present.items():
            self.put(name, value)


class VirtualDynamixel(RegisterServo):
    """One Dynamixel servo."""

    word_bytes = 2
    answers_writes = 2
    refuses, pinged = True, ("model", "firmware")
    factory: ClassVar[Mapping[str, int]] = {
        "firmware": 46,
        "baud": 3,
        "return_delay": 250,
        "operating_mode": 3,
        "max_temperature": 70,
        "max_voltage": 140,
        "min_voltage": 35,
        "status_level": 2,
        "position_p": 400,
    }

    def _status(self, refused: Refusal | None, data: bytes = b"") -> Packet:
        errors = {None: 0, "instruction": 2, "range": 4, "length": 5, "access": 7}
        error = errors[refused] | (ALERT if self.get("errors") else 0)
        return Packet(self.servo_id, Instruction.STATUS, bytes((error,)) + data)


class VirtualFeetech(RegisterServo):
    """One Feetech servo (STS or SMS)."""

    word_bytes = 1
    answers_writes = 1
    refuses, pinged = False, ()
    factory: ClassVar[Mapping[str, int]] = {
        "status_level": 1,
        "max_temperature": 70,
        "max_voltage": 140,
        "min_voltage": 40,
        "max_torque": 1000,
        "position_p": 32,
        "position_d": 32,
    }

    def _status(self, refused: Refusal | None, data: bytes = b"") -> Packet:
        return Packet(self.servo_id, self.get("errors"), data)
