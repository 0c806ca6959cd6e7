"""The robot's radio, by UDP."""

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
    """A radio at ``udp://HOST:PORT``. What it does not answer is lost, not an error.

    An answer to another datagram than the last one comes too late and is dropped.

    Raises:
        InputError: If the address is none.
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
        # refused: nobody listens there just now, as while the robot starts anew
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.send(request(self._number, data))

    def read(self, deadline: float) -> bytes:
        """What has arrived by ``deadline``, as soon as something has."""
        while True:
            left = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._socket], [], [], left)[0]:
                return b""
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                found = read_answer(self._socket.recv(LARGEST))
                if found.number in (None, self._number) and found.data:
                    self.device_s = found.clock_s
                    return found.data

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()
