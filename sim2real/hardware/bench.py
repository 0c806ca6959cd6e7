"""The servos that a scan finds, and a bench of them: loads, limits and data sheets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from sim2real.errors import InputError
from sim2real.hardware.registers import model_named
from sim2real.hardware.servo_bus import Found, ServoBus

LONGEST_REACH_RAD = 2.5


def scan(
    bus: ServoBus, ids: Iterable[int], patience_s: float, *, attempts: int = 3
) -> tuple[list[Found], list[int]]:
    """Servos that answer, and identities with corrupted answers; nothing is written to them."""
    servos, garbled = [], []
    for servo_id in ids:
        before = bus.garbled
        if any(bus.answers(servo_id, patience_s) for _ in range(attempts)):
            servos.append(bus.look(servo_id, patience_s))
        elif bus.garbled > before:
            garbled.append(servo_id)
    return servos, garbled


def table(servos: Sequence[Found]) -> str:
    """The servos as a table, one line each."""
    width = max(len(servo.model) for servo in servos)
    width = max(width, len("model")) if width else 0
    named = f" {'model':<{width}}" if width else ""
    lines = [f"{'id':>3}{named} {'ticks':>6} {'rad':>7} {'supply':>8} {'temp':>5}  torque  errors"]
    for servo in servos:
        ticks = "-" if servo.ticks is None else f"{servo.ticks}"
        angle = "-" if servo.angle_rad is None else f"{servo.angle_rad:+.3f}"
        supply = "-" if servo.supply_V is None else f"{servo.supply_V:.2f} V"
        temperature = "-" if servo.temperature_C is None else f"{servo.temperature_C} C"
        torque = "-" if servo.powered is None else "on" if servo.powered else "off"
        errors = ", ".join(servo.errors) or "none"
        named = f" {servo.model:<{width}}" if width else ""
        lines.append(
            f"{servo.servo_id:>3}{named} {ticks:>6} {angle:>7} {supply:>8} {temperature:>5}  "
            f"{torque:<6}  {errors}"
        )
    return "\n".join(lines)


@dataclass(frozen=True)
class Weight:
    """A mass at the end of an arm: kg and m."""

    mass_kg: float
    arm_m: float

    def load(self, *, hangs: bool) -> dict[str, float]:
        """Its load, as in a recording's JSON; with gravity, if it hangs straight down at 0."""
        entry = {"inertia_kgm2": self.mass_kg * self.arm_m**2}
        if hangs:
            entry |= {"pendulum_mass_kg": self.mass_kg, "pendulum_length_m": self.arm_m}
        return entry


def loads(
    names: Sequence[str], given: Sequence[Weight | float | None], *, hangs: bool
) -> Mapping[str, dict[str, float]]:
    """Loads by joint: of a weight, of an inertia in kg m2, or none."""
    return {
        name: what.load(hangs=hangs) if isinstance(what, Weight) else {"inertia_kgm2": what}
        for name, what in zip(names, given, strict=True)
        if what is not None
    }


def robot_text(bus: str, servos: Sequence[Found], reach_rad: float) -> str:
    """A ``robot.toml`` with a joint of +-``reach_rad`` a servo; ``InputError`` without ratings."""
    if not 0 < reach_rad <= LONGEST_REACH_RAD:
        expected = f"more than 0 and at most {LONGEST_REACH_RAD:g} rad"
        raise InputError("--reach", "", f"{reach_rad:g} rad", expected)
    parts = [_servo_text(bus, f"j{k + 1}", servo) for k, servo in enumerate(servos)]
    parts += [f'[[links]]\nname = "link{k + 1}"\n' for k in range(len(servos) + 1)]
    limits = f"limits_rad = [{-reach_rad:g}, {reach_rad:g}]"
    names = [f"j{k + 1}" for k in range(len(servos))]
    parts += [f'[[joints]]\nname = "{name}"\nservo = "{name}"\n{limits}\n' for name in names]
    return "\n".join(['name = "bench"', *parts])


def _servo_text(bus: str, name: str, servo: Found) -> str:
    model, supply = model_named(bus, servo.model), servo.supply_V
    rating = None if model is None or supply is None else model.rating(supply)
    if model is None or rating is None:
        found = f"no ratings of servo {servo.servo_id} ({servo.model or bus})"
        raise InputError("--robot", "", found, "a robot.toml with its torque and speed")
    return f"""
# {model.name} at {rating.supply_V:g} V: {model.source}
[servos.{name}]
max_torque_Nm = {rating.stall_torque_Nm:g}
no_load_speed_rad_s = {rating.no_load_speed_rad_s:.3f}
position_step_rad = {2 * math.pi / model.ticks_per_turn:.6f}
"""
