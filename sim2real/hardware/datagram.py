"""What a datagram to the robot's radio and its answer look like.

To the radio: ``4C 58``, a number that counts up (two bytes, low first), then LX packets, which it
plays on its bus in order. Its answer: the same four bytes, its clock in microseconds when it took
the datagram (eight bytes, low first), then every byte that the servos replied. A plain bridge from
UDP to serial serves too: servos ignore bytes ahead of a header, and an answer that does not begin
with ``4C 58`` is all reply.
"""

from __future__ import annotations

from dataclasses import dataclass

MARK = b"\x4c\x58"
_HEAD, _CLOCK = len(MARK) + 2, 8
LARGEST = 2048
NUMBERS = 1 << 16


@dataclass(frozen=True, slots=True)
class Datagram:
    """A datagram taken apart; ``number`` and ``clock_s`` are None where it does not tell them."""

    data: bytes
    number: int | None = None
    clock_s: float | None = None


def request(number: int, data: bytes) -> bytes:
    """The datagram that carries ``data`` to the radio."""
    return MARK + number.to_bytes(2, "little") + data


def answer(number: int, clock_s: float, data: bytes) -> bytes:
    """The datagram that carries replies back."""
    return request(number, round(1e6 * clock_s).to_bytes(_CLOCK, "little") + data)


def read_request(datagram: bytes) -> Datagram:
    """A datagram as the radio sees it."""
    if not datagram.startswith(MARK) or len(datagram) < _HEAD:
        return Datagram(datagram)
    return Datagram(datagram[_HEAD:], int.from_bytes(datagram[len(MARK) : _HEAD], "little"))


def read_answer(datagram: bytes) -> Datagram:
    """A datagram as this side sees it."""
    if not datagram.startswith(MARK) or len(datagram) < _HEAD + _CLOCK:
        return Datagram(datagram)
    clock = int.from_bytes(datagram[_HEAD : _HEAD + _CLOCK], "little") * 1e-6
    number = int.from_bytes(datagram[len(MARK) : _HEAD], "little")
    return Datagram(datagram[_HEAD + _CLOCK :], number, clock)
