"""A bus of servos: what the commands need of it, and requests with deadlines and repetition."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from sim2real.hardware.frames import FrameDecoder, Packet, Protocol
from sim2real.hardware.transport import Transport

T = TypeVar("T")
INSISTENCE = 10
"""Attempts at a request to a servo that must answer."""
PATIENCE_S = 0.03
"""Time to wait for the answer to such a request."""
QUIET_S = 0.02
"""Silence after a missing answer before the next request."""


@dataclass(frozen=True)
class BusServo:
    """A servo on the bus: the ticks in which it counts angles, and its range of set-points.

    ``quantities`` are columns of what it reports in each cycle besides its position.
    """

    servo_id: int
    tick_rad: float
    centre_ticks: int
    lowest_ticks: int
    largest_ticks: int
    quantities: tuple[str, ...]

    def angle(self, ticks: float) -> float:
        """Angle from the centre in rad."""
        return (ticks - self.centre_ticks) * self.tick_rad


@dataclass(frozen=True)
class Reading:
    """What a servo reported in a cycle; None or NaN for values without a reply."""

    position_ticks: int | None = None
    goal_ticks: int | None = None
    velocity_rad_s: float = math.nan
    current_A: float = math.nan
    load: float = math.nan
    supply_V: float = math.nan
    temperature_C: float = math.nan


@dataclass(frozen=True)
class Cycle:
    """One round over the bus.

    The set-points arrived at the servos at ``sent_s`` by ``time.monotonic``; the mean if they are
    addressed one after the other. ``round_trip_s`` is the longest time to an answer, ``device_s``
    the clock of a remote device; NaN without.
    """

    sent_s: float
    readings: tuple[Reading, ...]
    round_trip_s: float
    device_s: float


@dataclass(frozen=True)
class Found:
    """A servo that answered a scan; None for values without a reply.

    ``model`` is its name or number, empty if the protocol does not tell it; ``errors`` are those
    that it reports, and limits stored in it that are exceeded.
    """

    servo_id: int
    model: str
    ticks: int | None
    angle_rad: float | None
    supply_V: float | None
    temperature_C: int | None
    powered: bool | None
    errors: tuple[str, ...]


class Stopped(Exception):
    """The servos must not be driven any further; the message is the reason."""


def reason(error: Stopped | OSError) -> str:
    """Why the servos are not driven any further, for a message."""
    if isinstance(error, Stopped):
        return str(error)
    return f"the port was lost ({error.strerror or error})"


class ServoBus:
    """Servos on one port, at ``baud`` bits per second. ``OSError`` if the port is lost.

    Each bus adds what the commands need of it, as ``LxBus`` does.
    """

    name: ClassVar[str]  # name of the bus on the command line
    # rates at which such servos are searched for, the usual first
    baud_rates: ClassVar[tuple[int, ...]]
    protocol: ClassVar[Protocol]  # frames of its packets
    longest_answer: ClassVar[int]  # largest number of bytes of an answer's frame

    def __init__(self, transport: Transport, baud: int | None = None) -> None:
        self._transport, self.baud = transport, baud or self.baud_rates[0]
        self._decoder = FrameDecoder(self.protocol, self.longest_answer)

    @property
    def garbled(self) -> int:
        """Number of corrupted packets until now."""
        return self._decoder.garbled

    def close(self) -> None:
        """Close the port."""
        self._transport.close()

    def transfer(
        self, data: bytes, expected: Sequence[Callable[[Packet], bool]], deadline: float
    ) -> list[Packet | None]:
        """Send encoded requests and wait for the replies until ``deadline``, by ``time.monotonic``.

        ``expected`` tell of each reply whether a packet is it. Others are ignored, such as the echo
        of a request on a single wire. Those that are missing are None.
        """
        replies: list[Packet | None] = [None] * len(expected)
        due = list(range(len(expected)))
        self._transport.write(data)
        while due:
            arrived = self._transport.read(deadline)
            if not arrived:
                break
            for packet in self._decoder.feed(arrived):
                k = next((k for k in due if expected[k](packet)), None)
                if k is not None:
                    replies[k] = packet
                    due.remove(k)
            if time.monotonic() > deadline:
                break
        return replies

    def drain(self, quiet_s: float = 0.0) -> None:
        """Discard late replies until a silence, lest they pass for those to later requests."""
        deadline = time.monotonic() + 0.001 + 5 * quiet_s
        while self._transport.read(time.monotonic() + quiet_s) and time.monotonic() < deadline:
            pass
        self._decoder.clear()

    def _insist(self, servo_id: int, ask: Callable[[], T | None]) -> T:
        """The first answer of a servo that must answer."""
        answer = self._insisted(ask)
        if answer is None:
            raise Stopped(f"no reply from servo {servo_id} ({self.name}, {self.baud} baud)")
        return answer

    def _insisted(self, ask: Callable[[], T | None]) -> T | None:
        for _ in range(INSISTENCE):
            answer = ask()
            if answer is not None:
                return answer
            self.drain(QUIET_S)
        return None

    def _wire_s(self, count: int) -> float:
        """Time of so many bytes on the wire, with start and stop bits."""
        return 10 * count / self.baud

    def _device_s(self, answered: bool) -> float:
        """Clock of the remote device at the last answer; NaN if it has none."""
        device_s = self._transport.device_s
        return math.nan if device_s is None or not answered else device_s
