"""Connections to virtual servos: a pseudo-terminal, or UDP datagrams as with the radio."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from sim2real.errors import InputError
from sim2real.hardware.datagram import LARGEST
from sim2real.hardware.virtual_bus import VirtualBus
from sim2real.hardware.virtual_radio import VirtualRadio

TICK_S = 0.02  # period of the simulation without requests


def serve_terminal(
    bus: VirtualBus[Any], announce: Callable[[str], object], stop: Callable[[], bool]
) -> None:
    """Serve a pseudo-terminal until ``stop``; ``announce`` is called with its name.

    If the host has set another rate than that of the bus, the servos understand nothing.

    Raises:
        InputError: On a system without pseudo-terminals.
    """
    try:
        import tty

        host, device = os.openpty()
    except (ImportError, AttributeError, OSError):
        expected = "a system that has them, or --udp"
        raise InputError("virtual-servo", "", "no pseudo-terminals", expected) from None
    try:
        tty.setraw(device)
        os.set_blocking(host, False)
        announce(os.ttyname(device))
        while not stop():
            if select.select([host], [], [], TICK_S)[0]:
                data = os.read(host, LARGEST)
                for reply in bus.receive(data) if _rate(device) in (None, bus.baud) else ():
                    with contextlib.suppress(BlockingIOError):  # no reader: the reply is lost
                        os.write(host, reply)
            bus.advance()
    finally:
        os.close(host)
        os.close(device)


def _rate(device: int) -> int | None:
    """Rate that the host has set; None if it has set none, or an unusual one."""
    import termios

    speed = termios.tcgetattr(device)[4]
    if speed == termios.B38400:  # of a new pseudo-terminal
        return None
    names = {getattr(termios, name): name for name in dir(termios) if name[:1] == "B"}
    name = names.get(speed, "")[1:]
    return int(name) if name.isdigit() else None


def serve_udp(
    bus: VirtualBus[Any],
    address: tuple[str, int],
    announce: Callable[[str], object],
    stop: Callable[[], bool],
    *,
    rng: np.random.Generator,
    loss: float = 0.0,
    key: bytes | None = None,
) -> None:
    """Serve a radio at ``address`` until ``stop``.

    Args:
        bus: The bus of the radio.
        address: Host and port; port 0 for any free port.
        announce: Called with ``udp://HOST:PORT``.
        stop: Whether to end.
        rng: Random number generator.
        loss: Share of lost datagrams in both directions.
        key: Key that the computer shares; none by default.

    Raises:
        InputError: If the address is not available.
    """
    radio = VirtualRadio(key)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as socket_:
        try:
            socket_.bind(address)
        except (OSError, OverflowError) as error:
            problem = f"{address[0]}:{address[1]} ({error})"
            raise InputError("--udp", "", problem, "an address of this computer") from None
        host, port = socket_.getsockname()
        announce(f"udp://{host}:{port}")
        while not stop():
            if select.select([socket_], [], [], TICK_S)[0]:
                with contextlib.suppress(ConnectionRefusedError):
                    _serve_datagram(socket_, radio, bus, rng, loss)
            bus.advance()


def _serve_datagram(
    socket_: socket.socket,
    radio: VirtualRadio,
    bus: VirtualBus[Any],
    rng: np.random.Generator,
    loss: float,
) -> None:
    datagram, sender = socket_.recvfrom(LARGEST)
    clock = time.monotonic()
    if rng.random() < loss:
        return
    packets = radio.receive(datagram, sender, clock)
    if packets is None:
        return
    reply = radio.answer(clock, b"".join(bus.receive(packets)))
    if rng.random() >= loss:
        socket_.sendto(reply, sender)
