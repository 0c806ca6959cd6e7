"""The robot's radio over UDP."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from urllib.parse import urlsplit

from sim2real.errors import InputError
from sim2real.hardware.datagram import LARGEST, NUMBERS, read_answer, request
from sim2real.hardware.port import EXPECTED


class UdpTransport:
    """A radio at ``udp://HOST:PORT``. Missing answers are not errors.

    Late answers, to other datagrams than the last one, are dropped.

    Raises:
        InputError: If the address is invalid.
    """

    together = True

    def __init__(self, url: str) -> None:
        self.device_s: float | None = None
        self._number = 0
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
        """Send ``data`` in one datagram."""
        self._number = (self._number + 1) % NUMBERS
        # refused: no listener at present, for example while the robot restarts
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(request(self._number, data))

    def read(self, deadline: float) -> bytes:
        """Wait for bytes until ``deadline``; empty if none arrive."""
        while True:
            remaining = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._socket], [], [], remaining)[0]:
                return b""
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                reply = read_answer(self._socket.recv(LARGEST))
                if reply.number in (None, self._number) and reply.data:
                    self.device_s = reply.clock_s
                    return reply.data

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
