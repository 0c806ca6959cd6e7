"""Format of datagrams to the robot's radio and of its answers.

To the radio: ``4C 58``, an increasing number (two bytes, low first), then LX packets, which it
sends on its bus in order. Its answer: the same four bytes, its clock in microseconds at reception
of the datagram (eight bytes, low first), then all bytes of the servos' replies. A simple bridge
from UDP to serial works as well: servos ignore bytes before a header, and an answer that does not
begin with ``4C 58`` consists of replies only.
"""

from __future__ import annotations

from dataclasses import dataclass

MARK = b"\x4c\x58"
_HEAD, _CLOCK = len(MARK) + 2, 8
LARGEST = 2048
NUMBERS = 1 << 16


@dataclass(frozen=True, slots=True)
class Datagram:
    """A parsed datagram; ``number`` and ``clock_s`` are None if it does not contain them."""

    data: bytes
    number: int | None = None
    clock_s: float | None = None


def request(number: int, data: bytes) -> bytes:
    """The datagram with ``data`` for the radio."""
    return MARK + number.to_bytes(2, "little") + data


def answer(number: int, clock_s: float, data: bytes) -> bytes:
    """The datagram with the replies."""
    return request(number, round(1e6 * clock_s).to_bytes(_CLOCK, "little") + data)


def read_request(datagram: bytes) -> Datagram:
    """Parse a datagram to the radio."""
    if not datagram.startswith(MARK) or len(datagram) < _HEAD:
        return Datagram(datagram)
    return Datagram(datagram[_HEAD:], int.from_bytes(datagram[len(MARK) : _HEAD], "little"))


def read_answer(datagram: bytes) -> Datagram:
    """Parse a datagram from the radio."""
    if not datagram.startswith(MARK) or len(datagram) < _HEAD + _CLOCK:
        return Datagram(datagram)
    clock = int.from_bytes(datagram[_HEAD : _HEAD + _CLOCK], "little") * 1e-6
    number = int.from_bytes(datagram[len(MARK) : _HEAD], "little")
    return Datagram(datagram[_HEAD + _CLOCK :], number, clock)
