"""Models of servos by number: scale, units and ratings from ``servo_models.toml``."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from sim2real.hardware.registers import LAYOUTS, TORQUE, Layout
from sim2real.hardware.servo_bus import Found, Reading, Scale

_FILE = Path(__file__).with_name("servo_models.toml")


@dataclass(frozen=True)
class Rating:
    """Ratings of a motor at a supply voltage: stall torque and no-load speed."""

    supply_V: float
    stall_torque_Nm: float
    no_load_speed_rad_s: float


@dataclass(frozen=True)
class ServoModel:
    """A model of servo.

    Attributes:
        name, bus: Its name, and that of its bus.
        ticks_per_turn, centre_ticks: Ticks of a turn, and at the centre.
        source: Where the figures come from.
        number: Number that it reports; None for all others with the first byte ``main_version``.
        current_unit_A: Unit of its current; None if it reports a load.
        gains: Divisors of the registers of gains, by name.
        ratings: Ratings by supply voltage.
    """

    name: str
    bus: str
    ticks_per_turn: float
    centre_ticks: int
    source: str
    number: int | None = None
    main_version: int | None = None
    current_unit_A: float | None = None
    gains: Mapping[str, float] = field(default_factory=dict)
    ratings: tuple[Rating, ...] = ()

    @property
    def layout(self) -> Layout:
        """Its registers."""
        return LAYOUTS[self.bus]

    @property
    def velocity_unit_rad_s(self) -> float:
        """Unit of its velocities."""
        return self.layout.velocity_unit_rad_s or self.scale(0, 0).tick_rad

    def scale(self, lowest_ticks: int, largest_ticks: int) -> Scale:
        """Conversion of its ticks, with the range of set-points that it accepts."""
        tick_rad = 2 * math.pi / self.ticks_per_turn
        return Scale(tick_rad, self.centre_ticks, lowest_ticks, largest_ticks)

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
        current = load = math.nan
        if self.current_unit_A is not None:  # in some servos, one register for either
            drive = values.get("present_current", values["present_load"])
            current = drive * self.current_unit_A
        if "load" in self.quantities:
            load = values["present_load"] / 1000
        return Reading(
            position_ticks=values["present_position"],
            goal_ticks=values["goal_position"],
            velocity_rad_s=values["present_velocity"] * self.velocity_unit_rad_s,
            current_A=current,
            load=load,
            supply_V=values["present_voltage"] / 10,
            temperature_C=float(values["present_temperature"]),
        )

    def found(self, servo_id: int, values: Mapping[str, int]) -> Found:
        """The state of a servo, from the registers that were read."""
        ticks, tenths = values.get("present_position"), values.get("present_voltage")
        bits, powered = values.get("errors", 0), values.get(TORQUE)
        errors = [what for bit, what in self.layout.errors.items() if bits >> bit & 1]
        low, high = values.get("min_voltage", 0), values.get("max_voltage", math.inf)
        if tenths is not None and not low <= tenths <= high:
            errors.append(f"supply outside {low / 10:.1f} to {high / 10:.1f} V")
        return Found(
            servo_id,
            model=self.name,
            ticks=ticks,
            angle_rad=None if ticks is None else self.scale(0, 0).angle(ticks),
            supply_V=None if tenths is None else tenths / 10,
            temperature_C=values.get("present_temperature"),
            powered=None if powered is None else powered != 0,
            errors=tuple(errors),
        )


@cache
def servo_models(bus: str | None = None) -> tuple[ServoModel, ...]:
    """All known models, or those of a bus."""
    content = tomllib.loads(_FILE.read_text(encoding="utf-8"))
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
