"""Models of servos by number: scale, units and ratings from ``servo_models.toml``."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from sim2real.hardware.registers import LAYOUTS, Layout
from sim2real.hardware.servo_bus import Scale

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
        name: Its name.
        family: Name of its registers' layout.
        bus: Name of its bus.
        baud: Rate of the factory.
        number: Number that it reports; None for all others of its main version.
        main_version: First byte of that number, for a model without a number.
        ticks_per_turn: Ticks of a turn.
        centre_ticks: Ticks at the centre.
        current_unit_A: Unit of its current; None if it reports a load.
        gains: Divisors of the registers of gains, by name.
        ratings: Ratings by supply voltage.
        source: Where the figures come from.
    """

    name: str
    family: str
    bus: str
    baud: int
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
        return LAYOUTS[self.family]

    def scale(self, lowest_ticks: int, largest_ticks: int) -> Scale:
        """Conversion of its ticks, with the range of set-points that it accepts."""
        tick_rad = 2 * math.pi / self.ticks_per_turn
        return Scale(tick_rad, self.centre_ticks, lowest_ticks, largest_ticks)

    def rating(self, supply_V: float) -> Rating | None:
        """The ratings at the voltage nearest to a supply."""
        return min(self.ratings, key=lambda r: abs(r.supply_V - supply_V), default=None)


@cache
def servo_models() -> tuple[ServoModel, ...]:
    """All known models."""
    content = tomllib.loads(_FILE.read_text(encoding="utf-8"))
    models = []
    for entry in content["models"]:
        values = content["families"][entry["family"]] | entry
        ratings = [_rating(*numbers) for numbers in values.pop("ratings", ())]
        models.append(ServoModel(**values, ratings=tuple(ratings)))
    return tuple(models)


def model_of(bus: str, number: int) -> ServoModel | None:
    """The model with a number on a bus; None if it is unknown."""
    known = [model for model in servo_models() if model.bus == bus]
    exact = next((model for model in known if model.number == number), None)
    return exact or next((model for model in known if model.main_version == number & 0xFF), None)


def model_named(bus: str, name: str) -> ServoModel | None:
    """The model with a name on a bus, ignoring case; None if it is unknown."""
    known = (model for model in servo_models() if model.bus == bus)
    return next((model for model in known if model.name.lower() == name.lower()), None)


def names(bus: str) -> Sequence[str]:
    """Names of the models of a bus."""
    return [model.name for model in servo_models() if model.bus == bus]


def _rating(supply_V: float, torque_Nm: float, speed_rpm: float) -> Rating:
    return Rating(supply_V, torque_Nm, speed_rpm * 2 * math.pi / 60)
