"""A servo of the library at another firmware gain or supply voltage.

The firmware turns the error of the angle into a duty cycle, and the duty cycle times the supply is
the voltage of the motor: kp is proportional to gain and supply, the stall torque and the damping by
the controller to the supply, and the back-EMF depends on neither (the circuit of a DC motor, any
text on motors). ``reports/servo_library.md`` has the error of this on recordings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sim2real.errors import InputError
from sim2real.model import JointModel
from sim2real.servo_library.entry import JOINT, ServoEntry

_WITH_SUPPLY = ("motor.stall_torque_Nm", "motor.no_load_speed_rad_s", "motor.resistance_rise")
"""The rise of the resistance is stated at the stall torque, which grows with the supply."""


def at(
    entry: ServoEntry, *, firmware_gain: float | None = None, supply_V: float | None = None
) -> ServoEntry:
    """The servo with another firmware gain or supply; its intervals are scaled likewise.

    The held-out error is that of the original settings and is omitted where they differ.

    Args:
        entry: The servo.
        firmware_gain: Proportional gain, in the firmware's unit.
        supply_V: Supply voltage, V.

    Raises:
        InputError: If a value is not above 0, the entry's gain is not known, or the supply of a
            servo without a torque-speed line is to be changed.
    """
    gain_ratio = volt_ratio = 1.0
    if firmware_gain is not None:
        if entry.firmware_gain is None:
            found = f"{entry.name}, whose firmware gain is not known"
            raise InputError("--firmware-gain", "", found, "a servo with a known gain")
        gain_ratio = _ratio("--firmware-gain", firmware_gain, entry.firmware_gain)
    if supply_V is not None:
        if entry.supply_V is None:
            found = f"{entry.name}, whose supply is not known"
            raise InputError("--supply", "", found, "a servo with a known supply")
        volt_ratio = _ratio("--supply", supply_V, entry.supply_V)
    if gain_ratio == 1 and volt_ratio == 1:
        return entry
    if volt_ratio != 1 and not entry.joint.motor.get("no_load_speed_rad_s"):
        found = f"{entry.name}, which has no torque-speed line"
        raise InputError("--supply", "", found, "a servo with the law 'motor'")
    joint = _scaled(entry.joint, gain_ratio, volt_ratio)
    settings: dict[str, Any] = {
        "supply_V": entry.supply_V and entry.supply_V * volt_ratio,
        "firmware_gain": entry.firmware_gain and entry.firmware_gain * gain_ratio,
    }
    origin: Mapping[str, Any] = entry.model.provenance
    changed = origin["servo"] | settings | {"scored_on": ""}
    changed["scaled_from"] = {"supply_V": entry.supply_V, "firmware_gain": entry.firmware_gain}
    model = replace(
        entry.model, joints={JOINT: joint}, fit={}, provenance={**origin, "servo": changed}
    )
    return replace(entry, **settings, scored_on="", model=model)


def _ratio(option: str, value: float, former: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise InputError(option, "", f"{value:g}", "a number above 0")
    return value / former


def _scaled(joint: JointModel, gain: float, volts: float) -> JointModel:
    stall = joint.motor.get("stall_torque_Nm", 0.0)
    speed = joint.motor.get("no_load_speed_rad_s", 0.0)
    back_emf = stall / speed if speed else joint.kd_Nms_per_rad
    # What damps more or less than the back-EMF is the controller, whose output is a duty cycle.
    kd = back_emf + volts * (joint.kd_Nms_per_rad - back_emf)
    factors = dict.fromkeys(_WITH_SUPPLY, volts)
    factors["kp_Nm_per_rad"] = gain * volts
    factors["kd_Nms_per_rad"] = kd / joint.kd_Nms_per_rad if joint.kd_Nms_per_rad else 1.0
    interval = {
        name: (low * factors.get(name, 1.0), high * factors.get(name, 1.0))
        for name, (low, high) in joint.interval.items()
    }
    motor = {name: x * factors.get(f"motor.{name}", 1.0) for name, x in joint.motor.items()}
    kp = joint.kp_Nm_per_rad * gain * volts
    return replace(joint, kp_Nm_per_rad=kp, kd_Nms_per_rad=kd, motor=motor, interval=interval)
