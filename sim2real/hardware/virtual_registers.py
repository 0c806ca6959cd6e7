"""A virtual servo that is controlled by registers: its memory and the motion of its shaft.

The protocols are in ``virtual_dynamixel`` and ``virtual_feetech``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from sim2real.hardware.registers import TORQUE
from sim2real.hardware.servo_models import ServoModel
from sim2real.hardware.virtual_shaft import Law, Shaft

Refusal = Literal["range", "access", "length"]
WATCHDOG_UNIT_S = 0.02
DELAY_UNIT_S = 2e-6
_STALL_A = 1.0
"""Current at the stall torque."""


class RegisterServo:
    """One servo on a virtual bus, initially at rest at its centre with its torque off.

    A set-point is approached with ``profile_velocity`` if that is not 0; ``profile_acceleration``
    is stored only. The current or load is the torque as a share of the stall torque.

    Args:
        servo_id: Identity.
        model: Its model.
        values: Initial values of registers, by name.
        law: Law of its shaft.
        now: Present time in s; later calls use the same clock.
        supply_V: Supply voltage.
        temperature_C: Initial temperature.
        heating_C_per_s: Rate of change of the temperature.

    Attributes:
        connected: False for a disconnected servo, which receives and sends nothing.
        memory: Its registers.
    """

    def __init__(
        self,
        servo_id: int,
        model: ServoModel,
        values: Mapping[str, int],
        law: Law,
        now: float,
        *,
        supply_V: float = 7.4,
        temperature_C: float = 30.0,
        heating_C_per_s: float = 0.0,
    ) -> None:
        self.servo_id, self.model, self.connected = servo_id, model, True
        self.memory = bytearray(256)
        self._layout, self._scale = model.layout, model.scale(0, 0)
        self._shaft = Shaft(law, now)
        self._born, self._heard, self._present = now, now, now
        self._supply_V = supply_V
        self._temperature_C, self._heating = temperature_C, heating_C_per_s
        rating = model.rating(supply_V)
        self._stall_Nm = law.kp_Nm_per_rad if rating is None else rating.stall_torque_Nm
        start = {"goal_position": model.centre_ticks, "servo_id": servo_id}
        for name, value in {**values, **start}.items():
            self.put(name, value)
        self._refresh(now)

    @property
    def powered(self) -> bool:
        """Whether its torque is on."""
        return self._shaft.powered

    @property
    def delay_s(self) -> float:
        """Time between the end of a request and the reply."""
        return self.get("return_delay") * DELAY_UNIT_S

    def get(self, name: str) -> int:
        """Value of a register."""
        register = self._layout[name]
        data = bytes(self.memory[register.address : register.end])
        return register.decode(data, self._layout.order)

    def put(self, name: str, value: int) -> None:
        """Set a register without any effect, for example when the servo is made."""
        register = self._layout[name]
        self.memory[register.address : register.end] = register.encode(value, self._layout.order)

    def advance(self, now: float) -> None:
        """Advance the simulation to ``now``; an expired watchdog stops the shaft."""
        self._shaft.angle(now)
        if "bus_watchdog" not in self._layout.registers or not self.powered:
            return
        limit = self.get("bus_watchdog") * WATCHDOG_UNIT_S
        if limit > 0 and now - self._heard > limit:
            self._shaft.hold(now)
            self.put("bus_watchdog", -1)

    def heard(self, now: float) -> None:
        """Note an instruction on the bus, to this or another servo."""
        self.advance(now)
        self._heard = now

    def read(self, address: int, count: int, now: float) -> bytes | None:
        """Bytes of the memory at ``now``; None outside of it."""
        if not 0 < count <= len(self.memory) - address:
            return None
        self._refresh(now)
        return bytes(self.memory[address : address + count])

    def write_own(self, address: int, count: int, blocks: bytes, now: float) -> None:
        """Write this servo's part of a sync write: blocks of an identity and ``count`` bytes."""
        for start in range(0, len(blocks) - count, count + 1):
            if blocks[start] == self.servo_id:
                self.write(address, blocks[start + 1 : start + 1 + count], now)

    def write(self, address: int, data: bytes, now: float) -> Refusal | None:
        """Write to the memory, with all effects; the reason if it is refused."""
        end = address + len(data)
        if not data or end > len(self.memory):
            return "length"
        names = [
            name
            for name, register in self._layout.registers.items()
            if address <= register.address and register.end <= end
        ]
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
            self._act(name, now)
        return None

    def _allowed(self, name: str) -> bool:
        value = self.get(name)
        if name == TORQUE:
            return value in (0, 1)
        if name == "bus_watchdog":
            return 0 <= value <= 127
        if name == "goal_position":
            low, high = self.get("min_position"), self.get("max_position")
            stopped = "bus_watchdog" in self._layout.registers and self.get("bus_watchdog") < 0
            return not stopped and (low <= value <= high or low == high)
        return True

    def _act(self, name: str, now: float) -> None:
        if name == TORQUE:
            self._shaft.hold(now)
            self._shaft.powered = self.get(TORQUE) == 1
        elif name == "goal_position" and self.powered:
            goal = self._scale.angle(self.get("goal_position"))
            way = abs(goal - self._shaft.angle(now))
            speed = self.get("profile_velocity") * self._velocity_unit
            self._shaft.command(now, goal, way / speed if speed else 0.0)
        elif name == "servo_id":
            self.servo_id = self.get("servo_id")

    @property
    def _velocity_unit(self) -> float:
        return self._layout.velocity_unit_rad_s or self._scale.tick_rad

    def _refresh(self, now: float) -> None:
        """Write the present values into the memory."""
        angle = self._shaft.angle(now)
        share = max(min(self._shaft.drive_Nm / self._stall_Nm, 1.0), -1.0)
        temperature = self._temperature_C + self._heating * (now - self._born)
        present = {
            "present_position": self._scale.centre_ticks + round(angle / self._scale.tick_rad),
            "present_velocity": round(self._shaft.speed / self._velocity_unit),
            "present_load": round(1000 * share),
            "present_voltage": round(10 * self._supply_V),
            "present_temperature": min(max(round(temperature), 0), 255),
        }
        if self.model.current_unit_A is not None:
            unit = self.model.current_unit_A
            name = "present_current"
            name = name if name in self._layout.registers else "present_load"
            present[name] = round(share * _STALL_A / unit)
        if "device_ms" in self._layout.registers:
            present["device_ms"] = int(1000 * now) % 32768
        bits = {what: bit for bit, what in self._layout.errors.items()}
        errors = present["present_temperature"] > self.get("max_temperature")
        low, high = self.get("min_voltage"), self.get("max_voltage")
        voltage = not low <= present["present_voltage"] <= high
        present["errors"] = errors << bits["temperature"] | voltage << bits["voltage"]
        for name, value in present.items():
            self.put(name, value)
