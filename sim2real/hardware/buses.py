"""The buses by name, and opening one."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module

from sim2real.errors import InputError, check_choice
from sim2real.hardware.journal import Changed, Journal
from sim2real.hardware.latency_timer import latency_advice
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
    with contextlib.closing(journal):
        if changed := journal.pending():
            transport.close()
            _restore(port, changed, journal)
            transport = open_transport(port, baud=rate)
        with _on(transport, name, rate) as bus:
            yield Connection(bus, journal, rate)


def _on(transport: Transport, name: str, baud: int) -> ServoBus:
    bus: ServoBus = bus_class(name)(transport, baud)  # type: ignore[call-arg]
    return bus


def _restore(port: str, changed: Changed, journal: Journal) -> None:
    """Restore the servos that an earlier command left changed, and say so in one line."""
    with _on(open_transport(port, baud=changed.baud), changed.bus, changed.baud) as bus:
        left = {k: saved for k, saved in changed.servos.items() if not bus.restore(k, saved)}
    listed = ", ".join(str(k) for k in changed.servos)
    if left:
        journal.write(Changed(changed.bus, changed.baud, left))
        silent = ", ".join(str(k) for k in left)
        outcome = f"no confirmation from {silent} (if they are gone, delete {journal.path})"
    else:
        journal.clear()
        outcome = "torque off, limits restored"
    print(f"{port}: servos {listed}, left on by an earlier command: {outcome}", file=sys.stderr)
