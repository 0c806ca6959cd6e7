"""How a host reaches virtual servos: a pseudo-terminal, or datagrams as through the radio."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import time
from collections.abc import Callable

import numpy as np

from sim2real.errors import InputError
from sim2real.hardware.datagram import LARGEST, answer, read_request
from sim2real.hardware.virtual_bus import VirtualBus

TICK_S = 0.02  # how often time passes for servos that nobody talks to


def serve_terminal(
    bus: VirtualBus, announce: Callable[[str], object], stop: Callable[[], bool]
) -> None:
    """Be a serial port until ``stop``; ``announce`` is told its name.

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
                for reply in bus.receive(os.read(host, LARGEST)):
                    with contextlib.suppress(BlockingIOError):  # nobody reads: it is lost
                        os.write(host, reply)
            bus.advance()
    finally:
        os.close(host)
        os.close(device)


def serve_udp(
    bus: VirtualBus,
    address: tuple[str, int],
    announce: Callable[[str], object],
    stop: Callable[[], bool],
    *,
    rng: np.random.Generator,
    loss: float = 0.0,
) -> None:
    """Be a radio at ``address`` until ``stop``; ``announce`` is told its URL.

    Args:
        bus: What the radio plays datagrams on.
        address: Host and port to listen at; port 0 is any that is free.
        announce: Told ``udp://HOST:PORT``.
        stop: Whether to end.
        rng: Source of chance.
        loss: Share of datagrams, either way, that never arrive.

    Raises:
        InputError: If the address can't be had.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as radio:
        try:
            radio.bind(address)
        except (OSError, OverflowError) as error:
            found = f"{address[0]}:{address[1]} ({error})"
            raise InputError("--udp", "", found, "an address of this computer") from None
        host, port = radio.getsockname()
        announce(f"udp://{host}:{port}")
        while not stop():
            if select.select([radio], [], [], TICK_S)[0]:
                with contextlib.suppress(ConnectionRefusedError):
                    _serve_datagram(radio, bus, rng, loss)
            bus.advance()


def _serve_datagram(
    radio: socket.socket, bus: VirtualBus, rng: np.random.Generator, loss: float
) -> None:
    datagram, sender = radio.recvfrom(LARGEST)
    clock = time.monotonic()
    if rng.random() < loss:
        return
    given = read_request(datagram)
    replies = b"".join(bus.receive(given.data))
    if rng.random() >= loss:
        whole = replies if given.number is None else answer(given.number, clock, replies)
        radio.sendto(whole, sender)
