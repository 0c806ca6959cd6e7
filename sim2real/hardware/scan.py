"""Search for servos on a bus, with their state."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sim2real.hardware.servo_bus import Found, ServoBus

ATTEMPTS = 3  # to find a servo


def scan(bus: ServoBus, ids: Iterable[int], patience_s: float) -> tuple[list[Found], list[int]]:
    """Ask each identity in turn; nothing is written to any servo.

    Args:
        bus: The bus.
        ids: Identities.
        patience_s: Time to wait for each reply.

    Returns:
        The servos that answered, and the identities with corrupted answers, possibly from several
        servos with the same identity.

    Raises:
        OSError: If the port is lost.
    """
    servos, garbled = [], []
    for servo_id in ids:
        before = bus.garbled
        if any(bus.answers(servo_id, patience_s) for _ in range(ATTEMPTS)):
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
