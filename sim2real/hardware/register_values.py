"""Values of registers in physical units."""

from __future__ import annotations

import math
from collections.abc import Mapping

from sim2real.hardware.registers import TORQUE
from sim2real.hardware.servo_bus import Found, Reading
from sim2real.hardware.servo_models import ServoModel


def quantities(model: ServoModel) -> tuple[str, ...]:
    """What a servo reports besides its position, named as the columns of a recording."""
    drive = [] if model.current_unit_A is None else ["current_A"]
    if "present_current" in model.layout.registers or not drive:
        drive.append("load")
    return ("velocity_rad_s", *drive, "temperature_C")


def reading_of(model: ServoModel, data: bytes) -> Reading:
    """Present values in physical units, from the block of the layout's ``reported``."""
    values = model.layout.decode(model.layout.reported, data)
    tick_rad = model.scale(0, 0).tick_rad
    velocity_unit = model.layout.velocity_unit_rad_s or tick_rad
    current = load = math.nan
    if "present_current" in values and model.current_unit_A is not None:
        current = values["present_current"] * model.current_unit_A
    elif model.current_unit_A is not None:  # one register for either
        current = values["present_load"] * model.current_unit_A
    if "load" in quantities(model):
        load = values["present_load"] / 1000
    return Reading(
        position_ticks=values["present_position"],
        goal_ticks=values["goal_position"],
        velocity_rad_s=values["present_velocity"] * velocity_unit,
        current_A=current,
        load=load,
        supply_V=values["present_voltage"] / 10,
        temperature_C=float(values["present_temperature"]),
    )


def found_servo(servo_id: int, model: ServoModel, values: Mapping[str, int]) -> Found:
    """The state of a servo, from the registers that were read."""
    ticks, tenths = values.get("present_position"), values.get("present_voltage")
    bits = values.get("errors", 0)
    errors = [what for bit, what in model.layout.errors.items() if bits >> bit & 1]
    low, high = values.get("min_voltage"), values.get("max_voltage")
    if tenths is not None and low is not None and high is not None and not low <= tenths <= high:
        errors.append(f"supply outside {low / 10:.1f} to {high / 10:.1f} V")
    powered = values.get(TORQUE)
    return Found(
        servo_id,
        model=model.name,
        ticks=ticks,
        angle_rad=None if ticks is None else model.scale(0, 0).angle(ticks),
        supply_V=None if tenths is None else tenths / 10,
        temperature_C=values.get("present_temperature"),
        powered=None if powered is None else powered != 0,
        errors=tuple(errors),
    )
