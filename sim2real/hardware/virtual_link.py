"""Connections to virtual servos: a pseudo-terminal, or the radio's end of ``datagram.py``."""

from __future__ import annotations

import contextlib
import math
import os
import secrets
import select
import time
from collections.abc import Callable

import numpy as np

from sim2real.errors import InputError
from sim2real.hardware.datagram import (
    AHEAD,
    HALF,
    LARGEST,
    NUMBERS,
    SEALED_NUMBERS,
    SILENCE_S,
    answer,
    opened,
    read_request,
)
from sim2real.hardware.virtual_bus import VirtualBus

TICK_S = 0.02  # period of the simulation without requests


def serve_terminal(
    bus: VirtualBus, announce: Callable[[str], object], stop: Callable[[], bool]
) -> None:
    """Serve a pseudo-terminal until ``stop``; ``announce`` is called with its name."""
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
    bus: VirtualBus,
    address: str,
    announce: Callable[[str], object],
    stop: Callable[[], bool],
    *,
    rng: np.random.Generator,
    loss: float = 0.0,
    key: bytes | None = None,
) -> None:
    """Serve a radio at HOST:PORT until ``stop``; it loses this share of datagrams each way."""
    radio, expected = VirtualRadio(key), "HOST:PORT of this computer, as 127.0.0.1:0"
    with opened(f"udp://{address}", "--udp", expected, bind=True) as end:
        host, port = end.getsockname()
        announce(f"udp://{host}:{port}")
        while not stop():
            if select.select([end], [], [], TICK_S)[0]:
                with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                    datagram, sender = end.recvfrom(LARGEST)
                    clock = time.monotonic()
                    heard = rng.random() >= loss
                    packets = radio.receive(datagram, sender, clock) if heard else None
                    if packets is not None:
                        reply = radio.answer(clock, b"".join(bus.receive(packets)))
                        if rng.random() >= loss:
                            end.sendto(reply, sender)
            bus.advance()


class VirtualRadio:
    """Requests of the sender that was heard first, until it is silent; with a key, if given."""

    def __init__(self, key: bytes | None = None) -> None:
        self._key, self._numbers = key, NUMBERS if key is None else SEALED_NUMBERS
        self._sender: object = None
        self._session, self._heard = b"", -math.inf
        self._number: int | None = None

    def receive(self, datagram: bytes, sender: object, now: float) -> bytes | None:
        """Packets for the servos; None for a datagram that is a stranger's, old or invalid."""
        request = read_request(datagram, self._key)
        if request is None:
            return None
        held, last = now - self._heard <= SILENCE_S, self._number
        if self._key is not None and request.number == 0:
            own = request.session[:HALF]
            if held:  # the request for this session may be repeated
                return (
                    b"" if (sender, own, 0) == (self._sender, self._session[:HALF], last) else None
                )
            self._session = own + secrets.token_bytes(HALF)
            self._sender, self._number, self._heard = sender, 0, now
            return b""
        if held or self._key is not None:
            step = 1  # those without a number are of a bridge
            if request.number is not None and last is not None:
                step = (request.number - last) % self._numbers
            ours = (sender, request.session) == (self._sender, self._session)
            if not ours or not 0 < step <= AHEAD:
                return None
        self._sender, self._session, self._number = sender, request.session, request.number
        released = request.number is not None and not request.data
        self._heard = -math.inf if released else now
        return request.data

    def answer(self, clock_s: float, replies: bytes) -> bytes:
        """The datagram that answers the last request."""
        if self._number is None:
            return replies
        return answer(self._number, clock_s, replies, self._session, self._key)
