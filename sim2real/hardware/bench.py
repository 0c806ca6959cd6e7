"""A bench of servos without a description of their own: loads, limits and data sheets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim2real.errors import InputError
from sim2real.hardware.servo_bus import Found
from sim2real.hardware.servo_models import model_named

LONGEST_REACH_RAD = 2.5


@dataclass(frozen=True)
class Weight:
    """A mass at the end of an arm: kg and m."""

    mass_kg: float
    arm_m: float


def load(weight: Weight, *, hangs: bool) -> dict[str, float]:
    """The load of a point mass, as in a recording's JSON.

    Args:
        weight: The mass and its distance from the shaft.
        hangs: Whether gravity acts: the mass hangs straight down at angle 0.
    """
    entry = {"inertia_kgm2": weight.mass_kg * weight.arm_m**2}
    if hangs:
        entry |= {"pendulum_mass_kg": weight.mass_kg, "pendulum_length_m": weight.arm_m}
    return entry


def joint_names(count: int) -> list[str]:
    """Names of the joints of a bench."""
    return [f"j{k + 1}" for k in range(count)]


def robot_text(bus: str, servos: Sequence[Found], reach_rad: float) -> str:
    """A ``robot.toml`` with one joint for each servo, and the ratings of its model.

    Args:
        bus: Name of the bus.
        servos: The servos, as a scan found them.
        reach_rad: Limit of every joint, to both sides of the centre.

    Raises:
        InputError: If the ratings of a model are not known.
    """
    if not 0 < reach_rad <= LONGEST_REACH_RAD:
        expected = f"more than 0 and at most {LONGEST_REACH_RAD:g} rad"
        raise InputError("--reach", "", f"{reach_rad:g} rad", expected)
    lines = ['name = "bench"']
    for name, servo in zip(joint_names(len(servos)), servos, strict=True):
        lines += _servo_lines(bus, name, servo)
    lines += [f'[[links]]\nname = "link{k + 1}"\n' for k in range(len(servos) + 1)]
    limits = f"limits_rad = [{-reach_rad:g}, {reach_rad:g}]"
    for name in joint_names(len(servos)):
        lines.append(f'[[joints]]\nname = "{name}"\nservo = "{name}"\n{limits}\n')
    return "\n".join(lines)


def _servo_lines(bus: str, name: str, servo: Found) -> list[str]:
    model = model_named(bus, servo.model)
    supply = servo.supply_V
    rating = None if model is None or supply is None else model.rating(supply)
    if model is None or rating is None:
        found = f"no ratings of servo {servo.servo_id} ({servo.model or bus})"
        raise InputError("--robot", "", found, "a robot.toml with its torque and speed")
    tick_rad = 2 * math.pi / model.ticks_per_turn
    return [
        f"\n# {model.name} at {rating.supply_V:g} V: {model.source}",
        f"[servos.{name}]",
        f"max_torque_Nm = {rating.stall_torque_Nm:g}",
        f"no_load_speed_rad_s = {rating.no_load_speed_rad_s:.3f}",
        f"position_step_rad = {tick_rad:.6f}\n",
    ]


def loads(
    names: Sequence[str], given: Sequence[Weight | float | None], *, hangs: bool
) -> Mapping[str, dict[str, float]]:
    """Loads by joint: of a weight, of an inertia in kg m2, or none."""
    entries = {}
    for name, what in zip(names, given, strict=True):
        if isinstance(what, Weight):
            entries[name] = load(what, hangs=hangs)
        elif what is not None:
            entries[name] = {"inertia_kgm2": what}
    return entries
