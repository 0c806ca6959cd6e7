"""What carries bytes to a servo bus and back, behind one small interface."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

from sim2real.errors import InputError
from sim2real.hardware.lx import BAUD_RATES
from sim2real.hardware.port import EXPECTED


class Transport(Protocol):
    """A way to the bus. Every call returns by its deadline; ``OSError`` means that it is gone.

    Attributes:
        together: Whether requests to several servos may be under way at once. A wire that both
            sides share does not allow it; a radio that plays them in order does.
        device_s: The far side's clock when it took the last answered request, if it has told.
    """

    together: bool
    device_s: float | None

    def write(self, data: bytes) -> None:
        """Send ``data``."""

    def read(self, deadline: float) -> bytes:
        """What has arrived; empty only if by ``deadline`` (``time.monotonic``) nothing has."""

    def close(self) -> None:
        """Let go of the port."""


def open_transport(url: str, *, baud: int = BAUD_RATES[0]) -> Transport:
    """The transport that ``url`` names.

    Args:
        url: A serial port (``/dev/ttyUSB0``, ``COM3``), one served over a network
            (``socket://``, ``rfc2217://``), or a radio (``udp://HOST:PORT``).
        baud: Bits a second, on a serial port.

    Raises:
        InputError: If there is no such port, or it cannot be opened.
    """
    if url.startswith("udp://"):
        from sim2real.hardware.transport_udp import UdpTransport

        return UdpTransport(url)
    if "://" not in url and os.name == "posix" and not Path(url).exists():
        raise InputError("--port", "", f"no port {url!r}", EXPECTED)
    try:
        from sim2real.hardware.transport_serial import SerialTransport
    except ModuleNotFoundError:
        expected = "it installed: pip install 'sim2real[hardware]'"
        raise InputError("--port", "", "no pyserial", expected) from None
    return SerialTransport(url, baud)
