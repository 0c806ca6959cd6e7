"""Search for servos on a bus, with their state."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sim2real.hardware.bus import Bus
from sim2real.hardware.lx import BusCommand, Packet, signed_word, supply_V, words

ATTEMPTS = 2  # to find a servo
INSISTENCE = 5  # attempts per request to a servo that was found


@dataclass(frozen=True)
class Found:
    """A servo on the bus; None for values without a reply.

    Attributes:
        servo_id: Identity.
        ticks: Position in ticks of 0.24 degrees.
        supply_V: Supply voltage.
        temperature_C: Temperature.
        powered: Whether its torque is on.
        errors: Limits stored in the servo that are exceeded. The protocol has no error register:
            LED_ERROR_READ is only a mask of the errors that switch the LED on.
    """

    servo_id: int
    ticks: int | None
    supply_V: float | None
    temperature_C: int | None
    powered: bool | None
    errors: tuple[str, ...]


def scan(bus: Bus, ids: Iterable[int], patience_s: float) -> tuple[list[Found], list[int]]:
    """Request the position of each identity in turn; nothing is written to any servo.

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
        if any(bus.ask(servo_id, BusCommand.POS_READ, patience_s) for _ in range(ATTEMPTS)):
            servos.append(_look(bus, servo_id, patience_s))
        elif bus.garbled > before:
            garbled.append(servo_id)
        bus.drain()
    return servos, garbled


def _look(bus: Bus, servo_id: int, patience_s: float) -> Found:
    def ask(command: BusCommand) -> Packet | None:
        replies = (bus.ask(servo_id, command, patience_s) for _ in range(INSISTENCE))
        return next((reply for reply in replies if reply is not None), None)

    position, supply = ask(BusCommand.POS_READ), ask(BusCommand.VIN_READ)
    temperature, load = ask(BusCommand.TEMP_READ), ask(BusCommand.LOAD_READ)
    hottest, range_mV = ask(BusCommand.TEMP_MAX_LIMIT_READ), ask(BusCommand.VIN_LIMIT_READ)
    errors = []
    if temperature and hottest and temperature.parameters[0] > hottest.parameters[0]:
        errors.append(f"above {hottest.parameters[0]} C")
    if supply and range_mV:
        low, high = (millivolts / 1000 for millivolts in words(range_mV))
        if not low <= supply_V(supply) <= high:
            errors.append(f"supply outside {low:.1f} to {high:.1f} V")
    return Found(
        servo_id,
        ticks=None if position is None else signed_word(position),
        supply_V=None if supply is None else supply_V(supply),
        temperature_C=None if temperature is None else temperature.parameters[0],
        powered=None if load is None else load.parameters[0] != 0,
        errors=tuple(errors),
    )
