"""The buses by name, and opening one."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib import import_module

from sim2real.errors import InputError, check_choice
from sim2real.hardware.journal import Changed, Journal
from sim2real.hardware.latency_timer import latency_advice
from sim2real.hardware.motion import release
from sim2real.hardware.servo_bus import ServoBus
from sim2real.hardware.transport import Transport, open_transport

BUSES: Mapping[str, tuple[str, str]] = {
    "lx": ("sim2real.hardware.lx_bus", "LxBus"),
    "dynamixel": ("sim2real.hardware.dynamixel_bus", "DynamixelBus"),
    "feetech": ("sim2real.hardware.feetech_bus", "FeetechBus"),
}
"""Module and class of each bus."""


@dataclass(frozen=True)
class Connection:
    """An open bus, with the journal of its port.

    Attributes:
        bus: The bus.
        journal: Where to note changes.
        baud: Bits per second.
    """

    bus: ServoBus
    journal: Journal
    baud: int


def bus_class(name: str) -> type[ServoBus]:
    """The class of a bus.

    Raises:
        InputError: If there is none with this name.
    """
    check_choice("--bus", "", name, BUSES)
    module, class_name = BUSES[name]
    found: type[ServoBus] = getattr(import_module(module), class_name)
    return found


@contextmanager
def connection(name: str, port: str, baud: int | None = None) -> Iterator[Connection]:
    """Context manager of an open bus.

    If an earlier command on this port could not restore its servos, this is done first.

    Args:
        name: Name of the bus.
        port: Serial port or URL.
        baud: Bits per second of a serial port; the usual rate of the bus by default.

    Raises:
        InputError: If there is no such bus or port, or another command uses the port.
    """
    usual = bus_class(name).baud_rates[0]
    rate = usual if baud is None else baud
    if rate <= 0:
        raise InputError("--baud", "", f"{rate}", "a rate above 0, such as 1000000")
    if advice := latency_advice(port):
        print(advice, file=sys.stderr)
    transport = open_transport(port, baud=rate)
    try:
        journal = Journal(port)
    except InputError:
        transport.close()
        raise
    with closing(journal):
        if pending := journal.pending():
            transport.close()
            _restore(port, pending, journal)
            transport = open_transport(port, baud=rate)
        with closing(_on(transport, name, rate)) as bus:
            yield Connection(bus, journal, rate)


def _on(transport: Transport, name: str, baud: int) -> ServoBus:
    bus: ServoBus = bus_class(name)(transport, baud)  # type: ignore[call-arg]
    return bus


def _restore(port: str, pending: Sequence[Changed], journal: Journal) -> None:
    """Restore the servos that an earlier command left changed, and say so in one line."""
    silent = list[int]()
    for name, baud in {(entry.bus, entry.baud): None for entry in pending}:
        entries = {e.servo_id: e for e in pending if (e.bus, e.baud) == (name, baud)}
        with closing(_on(open_transport(port, baud=baud), name, baud)) as bus:
            left = release(bus, {servo_id: entry.values for servo_id, entry in entries.items()})
        journal.forget([entry for servo_id, entry in entries.items() if servo_id not in left])
        silent += left
    listed = ", ".join(str(entry.servo_id) for entry in pending)
    outcome = "torque off, limits restored"
    if silent:
        names = ", ".join(str(servo_id) for servo_id in silent)
        outcome = f"no confirmation from {names} (if they are gone, delete {journal.path})"
    print(f"{port}: servos {listed}, left on by an earlier command: {outcome}", file=sys.stderr)
