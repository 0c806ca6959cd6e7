"""The servos that a scan finds, and a bench of them: loads, limits and data sheets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from sim2real.errors import InputError
from sim2real.hardware.buses import Bus
from sim2real.hardware.registers import model_named
from sim2real.hardware.servo_bus import Found


def scan(
    bus: Bus, ids: Iterable[int], patience_s: float, *, attempts: int = 3
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


def load_of(mass_kg: float, arm_m: float, *, hangs: bool) -> dict[str, float]:
    """Load of a mass at the end of an arm, as in a recording's JSON.

    With gravity if it hangs straight down at 0; otherwise the shaft is vertical.
    """
    load = {"inertia_kgm2": mass_kg * arm_m**2}
    return load | ({"pendulum_mass_kg": mass_kg, "pendulum_length_m": arm_m} if hangs else {})


def robot_text(
    bus: str, servos: Sequence[Found], reach_rad: float, *, longest_rad: float = 2.5
) -> str:
    """A ``robot.toml`` with a joint of +-``reach_rad`` a servo; ``InputError`` without ratings."""
    if not 0 < reach_rad <= longest_rad:
        expected = f"more than 0 and at most {longest_rad:g} rad"
        raise InputError("--reach", "", f"{reach_rad:g} rad", expected)
    parts, joints = ['name = "bench"'], []
    for k, servo in enumerate(servos, start=1):
        model, supply = model_named(bus, servo.model), servo.supply_V
        rating = None if model is None or supply is None else model.rating(supply)
        if model is None or rating is None:
            found = f"no ratings of servo {servo.servo_id} ({servo.model or bus})"
            raise InputError("--robot", "", found, "a robot.toml with its torque and speed")
        parts.append(f"""
# {model.name} at {rating.supply_V:g} V: {model.source}
[servos.j{k}]
max_torque_Nm = {rating.stall_torque_Nm:g}
no_load_speed_rad_s = {rating.no_load_speed_rad_s:.3f}
position_step_rad = {2 * math.pi / model.ticks_per_turn:.6f}
""")
        limits = f"limits_rad = [{-reach_rad:g}, {reach_rad:g}]"
        joints.append(f'[[joints]]\nname = "j{k}"\nservo = "j{k}"\n{limits}\n')
    links = [f'[[links]]\nname = "link{k + 1}"\n' for k in range(len(servos) + 1)]
    return "\n".join([*parts, *links, *joints])
