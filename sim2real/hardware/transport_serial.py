"""A serial port, on this computer or served over a network, through pyserial."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Thread

import serial

from sim2real.errors import InputError
from sim2real.hardware.port import EXPECTED

PATIENCE_S = 0.05  # of one read: how soon the port closes
WRITE_TIMEOUT_S = 0.5


class SerialTransport:
    """A serial port, ``socket://HOST:PORT`` or ``rfc2217://HOST:PORT``, 8 bits, no parity.

    Two threads of its own wait for the port, which under load can take tens of milliseconds for a
    call that should not block: whoever keeps a schedule must not. They have the priority of the
    thread that opens it.

    Raises:
        InputError: If it cannot be opened.
    """

    together = False
    device_s: float | None = None

    def __init__(self, url: str, baud: int) -> None:
        # pyserial has no write timeout over RFC 2217
        write_timeout = None if url.startswith("rfc2217:") else WRITE_TIMEOUT_S
        try:
            self._port = serial.serial_for_url(
                url, baudrate=baud, timeout=PATIENCE_S, write_timeout=write_timeout
            )
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError("--port", "", f"{url!r} ({reason})", EXPECTED) from None
        self._arrived: SimpleQueue[bytes] = SimpleQueue()
        self._leaving: SimpleQueue[bytes] = SimpleQueue()  # an empty piece ends it
        self._open, self._failure = True, ""
        self._threads = [
            Thread(target=self._until_it_fails, args=(work,), daemon=True)
            for work in (self._receive, self._send)
        ]
        for thread in self._threads:
            thread.start()

    def write(self, data: bytes) -> None:
        """Send ``data``; ``OSError`` if the port is gone."""
        self._check()
        self._leaving.put(data)

    def read(self, deadline: float) -> bytes:
        """What has arrived by ``deadline``, as soon as something has."""
        self._check()
        try:
            return self._arrived.get(timeout=max(deadline - time.monotonic(), 0.0))
        except Empty:
            self._check()
            return b""

    def close(self) -> None:
        """Let go of the port when all is sent."""
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
            self._arrived.put(b"")  # whoever waits learns of it now

    def _receive(self) -> None:
        while self._open:
            first = self._port.read(1)
            if first:
                self._arrived.put(bytes(first + self._port.read(self._port.in_waiting)))

    def _send(self) -> None:
        while data := self._leaving.get():
            self._port.write(data)
