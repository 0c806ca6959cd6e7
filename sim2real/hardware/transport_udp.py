"""The robot's radio over UDP."""

from __future__ import annotations

import contextlib
import secrets
import select
import socket
import time
from urllib.parse import urlsplit

from sim2real.errors import InputError
from sim2real.hardware.datagram import (
    HALF,
    LARGEST,
    NUMBERS,
    SEALED_NUMBERS,
    Datagram,
    read_answer,
    request,
)
from sim2real.hardware.port import EXPECTED

PATIENCE = 25
"""Datagrams without an answer after which a new session is begun, with a key."""


class UdpTransport:
    """A radio at ``udp://HOST:PORT``. Missing answers are not errors.

    Late answers, to other datagrams than the last one, are dropped.

    Args:
        url: The address.
        key: Key that the radio shares; none by default.

    Raises:
        InputError: If the address is invalid.
    """

    together = True

    def __init__(self, url: str, key: bytes | None = None) -> None:
        self.device_s: float | None = None
        self._key, self._numbers = key, NUMBERS if key is None else SEALED_NUMBERS
        self._number, self._unanswered = 0, 0
        self._own, self._session = secrets.token_bytes(HALF), b""
        self._waiting = b""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            address = urlsplit(url)
            self._socket.connect((address.hostname, address.port or 0))
            self._socket.getpeername()
        except (OSError, ValueError, UnicodeError, TypeError) as error:
            self._socket.close()
            raise InputError("--port", "", f"{url!r} ({error})", EXPECTED) from None

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
                if self._key is not None and not self._of_this_session(reply):
                    continue
                self._unanswered = 0
                if reply.data:
                    self.device_s = reply.clock_s
                    return reply.data

    def _of_this_session(self, reply: Datagram) -> bool:
        """Whether an answer is to this session; the first one completes it."""
        session = reply.session or b""
        if not self._session and session.startswith(self._own):
            self._session, self._unanswered = session, 0
            self.write(self._waiting)
        return session == self._session

    def _send(self, datagram: bytes) -> None:
        # refused: no listener at present, for example while the robot restarts
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(datagram)

    def close(self) -> None:
        """Release the radio and close the socket."""
        if self._number:
            self._number = (self._number + 1) % self._numbers
            self._send(request(self._number, b"", self._session, self._key))
        self._socket.close()
