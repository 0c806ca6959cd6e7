"""Registers of Dynamixel and Feetech servos; their models are in ``servo_models.toml``."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from sim2real.hardware.servo_bus import BusServo, Reading


@dataclass(frozen=True)
class Register:
    """A number of ``size`` bytes in the memory of a servo, in two's complement if ``signed``."""

    address: int
    size: int
    sign_bit: int | None = None
    signed: bool = False

    @property
    def end(self) -> int:
        """Address behind its last byte."""
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        """The bytes of a value; ``OverflowError`` if it does not fit."""
        if self.sign_bit is not None:
            if abs(value) >> self.sign_bit:
                raise OverflowError(f"{value} does not fit into {self.sign_bit} bits")
            value = abs(value) | (value < 0) << self.sign_bit
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        """The value of ``size`` bytes."""
        value = int.from_bytes(data, "little", signed=self.signed)
        if self.sign_bit is not None and value >> self.sign_bit & 1:
            return -(value & ~(1 << self.sign_bit))
        return value


@dataclass(frozen=True)
class Layout:
    """The registers of the servos of a bus, under the same names for every bus.

    The memory below ``volatile_from`` (EEPROM) is never written; the rest is lost without supply.
    """

    registers: Mapping[str, Register]
    volatile_from: int
    reported: tuple[str, ...]  # in each cycle, by one instruction
    settings: tuple[str, ...]  # stored in a recording
    changed: Mapping[str, int]  # values during a recording, in the order of their restoration
    position_modes: Mapping[int, str]  # operating modes in which a set-point is an angle
    errors: Mapping[int, str]  # names of the bits of the register ``errors``
    multi_turn_modes: tuple[int, ...] = ()  # those without the stored range of positions
    velocity_unit_rad_s: float | None = None  # None for ticks per second

    def __getitem__(self, name: str) -> Register:
        return self.registers[name]

    def span(self, names: Sequence[str]) -> tuple[int, int]:
        """First address and number of bytes of the smallest block that contains the registers."""
        registers = [self.registers[name] for name in names]
        start = min(register.address for register in registers)
        return start, max(register.end for register in registers) - start

    def decode(self, names: Sequence[str], data: bytes) -> dict[str, int]:
        """Values in the block of ``span(names)``."""
        start, _ = self.span(names)
        registers = {name: self.registers[name] for name in names}
        return {
            name: r.decode(data[r.address - start : r.end - start]) for name, r in registers.items()
        }


def _signed(address: int, size: int) -> Register:
    return Register(address, size, signed=True)


TORQUE = "torque_enable"
_REPORTED = (
    "goal_position", "present_position", "present_velocity", "present_load", "present_voltage",
    "present_temperature",
)  # fmt: skip
_SETTINGS = (
    "firmware", "return_delay", "status_level", "position_p", "position_i", "position_d",
    "operating_mode", "profile_velocity", "profile_acceleration",
)  # fmt: skip
LAYOUTS: Mapping[str, Layout] = {
    # DYNAMIXEL X and MX (Protocol 2.0), control table of the e-Manual
    "dynamixel": Layout(
        registers={
            "model": Register(0, 2), "firmware": Register(6, 1), "servo_id": Register(7, 1),
            "baud": Register(8, 1), "return_delay": Register(9, 1), "drive_mode": Register(10, 1),
            "operating_mode": Register(11, 1), "homing_offset": _signed(20, 4),
            "max_temperature": Register(31, 1), "max_voltage": Register(32, 2),
            "min_voltage": Register(34, 2), "max_position": _signed(48, 4),
            "min_position": _signed(52, 4), TORQUE: Register(64, 1),
            "status_level": Register(68, 1), "errors": Register(70, 1),
            "position_d": Register(80, 2), "position_i": Register(82, 2),
            "position_p": Register(84, 2), "bus_watchdog": _signed(98, 1),
            "profile_acceleration": Register(108, 4), "profile_velocity": Register(112, 4),
            "goal_position": _signed(116, 4), "present_load": _signed(126, 2),
            "present_velocity": _signed(128, 4), "present_position": _signed(132, 4),
            "present_voltage": Register(144, 2), "present_temperature": Register(146, 1),
        },
        volatile_from=64,
        reported=_REPORTED,
        settings=(*_SETTINGS, "drive_mode", "homing_offset"),
        changed={"bus_watchdog": 25, "profile_velocity": 0, "profile_acceleration": 0},
        position_modes={3: "position", 4: "extended position", 5: "current-based position"},
        errors={0: "voltage", 2: "temperature", 3: "encoder", 4: "electrical", 5: "overload"},
        multi_turn_modes=(4, 5),
        velocity_unit_rad_s=0.229 * 0.10471975511965977,  # 0.229 rev/min
    ),
    # Feetech STS and SMS, memory table of the STS series
    "feetech": Layout(
        registers={
            "firmware": Register(0, 2), "model": Register(3, 2), "servo_id": Register(5, 1),
            "baud": Register(6, 1), "return_delay": Register(7, 1), "status_level": Register(8, 1),
            "min_position": Register(9, 2), "max_position": Register(11, 2),
            "max_temperature": Register(13, 1), "max_voltage": Register(14, 1),
            "min_voltage": Register(15, 1), "max_torque": Register(16, 2),
            "position_p": Register(21, 1), "position_d": Register(22, 1),
            "position_i": Register(23, 1), "position_offset": Register(31, 2, sign_bit=11),
            "operating_mode": Register(33, 1), TORQUE: Register(40, 1),
            "profile_acceleration": Register(41, 1), "goal_position": Register(42, 2, sign_bit=15),
            "profile_velocity": Register(46, 2, sign_bit=15),
            "present_position": Register(56, 2, sign_bit=15),
            "present_velocity": Register(58, 2, sign_bit=15),
            "present_load": Register(60, 2, sign_bit=10), "present_voltage": Register(62, 1),
            "present_temperature": Register(63, 1), "errors": Register(65, 1),
            "present_current": Register(69, 2, sign_bit=15),
        },
        volatile_from=40,
        reported=(*_REPORTED, "present_current"),
        settings=(*_SETTINGS, "max_torque", "position_offset"),
        changed={"profile_velocity": 0, "profile_acceleration": 0},
        position_modes={0: "position"},
        errors={0: "voltage", 1: "sensor", 2: "temperature", 3: "current", 5: "overload"},
    ),
}  # fmt: skip
"""By the name of the bus."""


@dataclass(frozen=True)
class Rating:
    """Ratings of a motor at a supply voltage: stall torque and no-load speed."""

    supply_V: float
    stall_torque_Nm: float
    no_load_speed_rad_s: float


@dataclass(frozen=True)
class ServoModel:
    """A model of servo on a bus."""

    name: str
    bus: str
    ticks_per_turn: float
    centre_ticks: int
    source: str  # where the figures come from
    number: int | None = None  # None for all others with the first byte ``main_version``
    main_version: int | None = None
    current_unit_A: float | None = None  # None if it reports a load
    # divisors of the registers of gains, by name
    gains: Mapping[str, float] = field(default_factory=dict)
    ratings: tuple[Rating, ...] = ()

    @property
    def layout(self) -> Layout:
        """Its registers."""
        return LAYOUTS[self.bus]

    @property
    def velocity_unit_rad_s(self) -> float:
        """Unit of its velocities."""
        return self.layout.velocity_unit_rad_s or 2 * math.pi / self.ticks_per_turn

    def servo(self, servo_id: int, lowest_ticks: int = 0, largest_ticks: int = 0) -> BusServo:
        """A servo of this model, with the range of set-points that it accepts."""
        tick_rad, ends = 2 * math.pi / self.ticks_per_turn, (lowest_ticks, largest_ticks)
        return BusServo(servo_id, tick_rad, self.centre_ticks, *ends, self.quantities)

    def rating(self, supply_V: float) -> Rating | None:
        """The ratings at the voltage nearest to a supply."""
        return min(self.ratings, key=lambda r: abs(r.supply_V - supply_V), default=None)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What it reports besides its position, named as the columns of a recording."""
        drive = [] if self.current_unit_A is None else ["current_A"]
        if "present_current" in self.layout.registers or not drive:
            drive.append("load")
        return ("velocity_rad_s", *drive, "temperature_C")

    def reading(self, data: bytes) -> Reading:
        """Present values in physical units, from the block of the layout's ``reported``."""
        values = self.layout.decode(self.layout.reported, data)
        current, load = math.nan, values["present_load"]
        if self.current_unit_A is not None:  # in some servos, one register for either
            current = values.get("present_current", load) * self.current_unit_A
        return Reading(
            position_ticks=values["present_position"],
            goal_ticks=values["goal_position"],
            velocity_rad_s=values["present_velocity"] * self.velocity_unit_rad_s,
            current_A=current,
            load=load / 1000 if "load" in self.quantities else math.nan,
            supply_V=values["present_voltage"] / 10,
            temperature_C=float(values["present_temperature"]),
        )


@cache
def servo_models(bus: str | None = None) -> tuple[ServoModel, ...]:
    """All known models, or those of a bus."""
    file = Path(__file__).with_name("servo_models.toml")
    content = tomllib.loads(file.read_text(encoding="utf-8"))
    models = []
    for entry in content["models"]:
        values = content["buses"][entry["bus"]] | entry
        ratings = tuple(
            Rating(supply_V, torque_Nm, speed_rpm * 2 * math.pi / 60)
            for supply_V, torque_Nm, speed_rpm in values.pop("ratings", ())
        )
        models.append(ServoModel(**values, ratings=ratings))
    return tuple(model for model in models if bus in (None, model.bus))


def model_of(bus: str, number: int) -> ServoModel | None:
    """The model with a number on a bus; None if it is unknown."""
    known = servo_models(bus)
    exact = next((model for model in known if model.number == number), None)
    return exact or next((model for model in known if model.main_version == number & 0xFF), None)


def model_named(bus: str, name: str) -> ServoModel | None:
    """The model with a name on a bus, ignoring case; None if it is unknown."""
    return next((m for m in servo_models(bus) if m.name.lower() == name.lower()), None)
