"""Transports of bytes to and from a servo bus: serial ports, local or not, and the radio."""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from sim2real.errors import InputError, optional
from sim2real.hardware.datagram import (
    HALF,
    LARGEST,
    NUMBERS,
    SEALED_NUMBERS,
    opened,
    read_answer,
    request,
    shared_key,
)

_PORTS = "a serial port, socket://HOST:PORT, rfc2217://HOST:PORT or udp://HOST:PORT"
PATIENCE = 25
"""Datagrams without an answer after which a new session is begun, with a key."""
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
            raise InputError("--port", "", f"{url!r} ({reason})", _PORTS) from None
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


class UdpTransport:
    """A radio at ``udp://HOST:PORT``, which shares ``key``; missing answers are not errors."""

    together = True  # the radio sends requests in order

    def __init__(self, url: str, key: bytes | None = None) -> None:
        self.device_s: float | None = None  # clock of the radio at the last answered request
        self._key, self._numbers = key, NUMBERS if key is None else SEALED_NUMBERS
        self._number, self._unanswered = 0, 0
        self._own, self._session = secrets.token_bytes(HALF), b""
        self._waiting = b""
        self._socket = opened(url, "--port", _PORTS)

    def write(self, data: bytes) -> None:
        """Send ``data`` in one datagram; with a key once the radio has answered in this session."""
        self._unanswered += 1
        if self._key is not None and self._session and self._unanswered > PATIENCE:
            self._own, self._session = secrets.token_bytes(HALF), b""
        if self._key is not None and not self._session:
            self._number, self._waiting = 0, data
            self._send(request(0, b"", self._own + bytes(HALF), self._key))
            return
        self._number = (self._number + 1) % self._numbers
        self._send(request(self._number, data, self._session, self._key))

    def read(self, deadline: float) -> bytes:
        """Wait for bytes until ``deadline``; empty if none arrive."""
        while True:
            remaining = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._socket], [], [], remaining)[0]:
                return b""
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                reply = read_answer(self._socket.recv(LARGEST), self._key)
                if reply is None or reply.number not in (None, self._number):
                    continue
                if self._key is not None:
                    if not self._session and reply.session.startswith(self._own):
                        # the first answer of a session completes it
                        self._session, self._unanswered = reply.session, 0
                        self.write(self._waiting)
                    if reply.session != self._session:
                        continue
                self._unanswered = 0
                if reply.data:
                    self.device_s = reply.clock_s
                    return reply.data

    def close(self) -> None:
        """Release the radio and close the socket."""
        if self._number:
            self._number = (self._number + 1) % self._numbers
            self._send(request(self._number, b"", self._session, self._key))
        self._socket.close()

    def _send(self, datagram: bytes) -> None:
        # refused: no listener at present, for example while the robot restarts
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(datagram)


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
        raise InputError("--port", "", f"no port {url!r}", _PORTS)
    return SerialTransport(url, baud)
