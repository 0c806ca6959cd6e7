"""Interface of the transports of bytes to and from a servo bus."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

from sim2real.errors import InputError
from sim2real.extras import optional
from sim2real.hardware.port import EXPECTED


class Transport(Protocol):
    """A connection to the bus. Calls return by their deadline; ``OSError`` if it is lost.

    Attributes:
        together: Whether requests to several servos may be pending at once. A shared wire does not
            allow it; a radio that sends them in order does.
        device_s: Clock of the remote device at the last answered request, if it sends one.
    """

    together: bool
    device_s: float | None

    def write(self, data: bytes) -> None:
        """Send ``data``."""

    def read(self, deadline: float) -> bytes:
        """Bytes that have arrived; empty only after ``deadline`` (``time.monotonic``)."""

    def close(self) -> None:
        """Close the port."""


def open_transport(url: str, *, baud: int = 115_200) -> Transport:
    """Open the transport of a URL.

    Args:
        url: A serial port (``/dev/ttyUSB0``, ``COM3``), one served over a network
            (``socket://``, ``rfc2217://``), or a radio (``udp://HOST:PORT``, with the key in the
            environment variable ``SIM2REAL_KEY`` if there is one).
        baud: Bits per second of a serial port.

    Raises:
        InputError: If there is no such port, or it cannot be opened.
    """
    if url.startswith("udp://"):
        from sim2real.hardware.shared_key import shared_key
        from sim2real.hardware.transport_udp import UdpTransport

        return UdpTransport(url, shared_key())
    if "://" not in url and os.name == "posix" and not Path(url).exists():
        raise InputError("--port", "", f"no port {url!r}", EXPECTED)
    with optional("--port"):
        from sim2real.hardware.transport_serial import SerialTransport
    return SerialTransport(url, baud)
