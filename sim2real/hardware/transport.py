"""Transports of bytes to and from a servo bus: serial ports, local or not, and the radio."""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from sim2real.errors import InputError, optional
from sim2real.hardware.radio import PORTS, UdpTransport, shared_key

READ_TIMEOUT_S = 0.05
WRITE_TIMEOUT_S = 0.5


class SerialTransport:
    """A serial port, ``socket://HOST:PORT`` or ``rfc2217://HOST:PORT``, 8 bits, no parity.

    Two threads read and write, as calls that should not block can take tens of milliseconds under
    load, which would disturb the timing of the caller. They have the priority of the thread that
    opens the port.
    """

    together = False  # requests to several servos must not be pending at once on a shared wire
    device_s: float | None = None  # there is no clock

    def __init__(self, url: str, baud: int) -> None:
        with optional("--port"):
            import serial
        # pyserial has no write timeout over RFC 2217
        write_timeout = None if url.startswith("rfc2217:") else WRITE_TIMEOUT_S
        try:
            self._port = serial.serial_for_url(
                url, baudrate=baud, timeout=READ_TIMEOUT_S, write_timeout=write_timeout
            )
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError("--port", "", f"{url!r} ({reason})", PORTS) from None
        self._arrived: SimpleQueue[bytes] = SimpleQueue()
        self._leaving: SimpleQueue[bytes] = SimpleQueue()  # an empty item ends the thread
        self._open, self._failure = True, ""
        self._threads = [
            Thread(target=self._until_it_fails, args=(work,), daemon=True)
            for work in (self._receive, self._send)
        ]
        for thread in self._threads:
            thread.start()

    def write(self, data: bytes) -> None:
        """Send ``data``; ``OSError`` if the port is lost."""
        self._check()
        self._leaving.put(data)

    def read(self, deadline: float) -> bytes:
        """Bytes that have arrived; empty only after ``deadline``, by ``time.monotonic``."""
        with contextlib.suppress(Empty):
            if data := self._arrived.get(timeout=max(deadline - time.monotonic(), 0.0)):
                return data
        self._check()
        return b""

    def close(self) -> None:
        """Close the port after all is sent."""
        self._open = False
        self._leaving.put(b"")
        for thread in self._threads:
            thread.join(WRITE_TIMEOUT_S)
        self._port.close()

    def _check(self) -> None:
        if self._failure:
            raise OSError(self._failure)

    def _until_it_fails(self, work: Callable[[], None]) -> None:
        try:
            work()
        except (OSError, TypeError, ValueError) as error:  # the latter from a port just closed
            self._failure = str(error) or type(error).__name__
            self._arrived.put(b"")  # wakes a waiting reader

    def _receive(self) -> None:
        while self._open:
            byte = self._port.read(1)
            if byte:
                self._arrived.put(bytes(byte + self._port.read(self._port.in_waiting)))

    def _send(self) -> None:
        while data := self._leaving.get():
            self._port.write(data)


Transport = SerialTransport | UdpTransport
"""A connection to the bus. Calls return by their deadline; ``OSError`` if it is lost."""


def open_transport(url: str, *, baud: int = 115_200) -> Transport:
    """Open a serial port (local, ``socket://``, ``rfc2217://``) or a radio (``udp://HOST:PORT``).

    The radio's key is in the environment variable ``SIM2REAL_KEY``, if there is one. ``InputError``
    if there is no such port, or it cannot be opened.
    """
    if url.startswith("udp://"):
        return UdpTransport(url, shared_key())
    if "://" not in url and os.name == "posix" and not Path(url).exists():
        raise InputError("--port", "", f"no port {url!r}", PORTS)
    return SerialTransport(url, baud)
