"""Search for servos on a bus, with their state."""

from __future__ import annotations

from collections.abc import Iterable

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
