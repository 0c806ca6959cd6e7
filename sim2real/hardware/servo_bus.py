"""Interface of the servo buses: what the commands need of servos, whatever their protocol."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

INSISTENCE = 10
"""Attempts at a request to a servo that must answer."""
PATIENCE_S = 0.03
"""Time to wait for the answer to such a request."""


@dataclass(frozen=True)
class Scale:
    """Conversion of the ticks in which a servo counts angles.

    Attributes:
        tick_rad: Angle of a tick.
        centre_ticks: Ticks at the servo's centre.
        lowest_ticks: Smallest set-point that the servo accepts.
        largest_ticks: Largest set-point that the servo accepts.
    """

    tick_rad: float
    centre_ticks: int
    lowest_ticks: int
    largest_ticks: int

    def angle(self, ticks: float) -> float:
        """Angle from the centre in rad."""
        return (ticks - self.centre_ticks) * self.tick_rad


@dataclass(frozen=True)
class BusServo:
    """A servo on the bus.

    Attributes:
        servo_id: Identity.
        model: Name of its model.
        scale: Its ticks.
        quantities: What it reports in each cycle besides its position, named as the columns of a
            recording.
    """

    servo_id: int
    model: str
    scale: Scale
    quantities: tuple[str, ...] = ()


@dataclass(frozen=True)
class Reading:
    """What a servo reported in a cycle; None or NaN for values without a reply.

    Attributes:
        position_ticks: Position.
        goal_ticks: Set-point in effect, if the servo reports it.
        velocity_rad_s: Speed.
        current_A: Motor current.
        load: Drive as a share of the largest, -1 to 1.
        supply_V: Supply voltage.
        temperature_C: Temperature.
    """

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

    Attributes:
        sent_s: Time at which the set-points arrived at the servos, by ``time.monotonic``; the mean
            if they are addressed one after the other.
        readings: What each servo reported.
        round_trip_s: Longest time to an answer; NaN without answers.
        device_s: Clock of a remote device; NaN if there is none.
    """

    sent_s: float
    readings: tuple[Reading, ...]
    round_trip_s: float
    device_s: float


@dataclass(frozen=True)
class Found:
    """A servo that answered a scan; None for values without a reply.

    Attributes:
        servo_id: Identity.
        model: Name or number of its model; empty if the protocol does not tell it.
        ticks: Position in ticks.
        angle_rad: Position from the servo's centre; None also for unknown models.
        supply_V: Supply voltage.
        temperature_C: Temperature.
        powered: Whether its torque is on.
        errors: Errors that it reports, and limits stored in it that are exceeded.
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


class ServoBus(Protocol):
    """Servos on one port. Methods raise ``OSError`` if the port is lost.

    Attributes:
        name: Name of the bus on the command line.
        baud_rates: Rates at which such servos are searched for, the usual first.
        largest_id: Largest identity.
        garbled: Number of corrupted packets until now.
    """

    name: ClassVar[str]
    baud_rates: ClassVar[tuple[int, ...]]
    largest_id: ClassVar[int]

    @property
    def garbled(self) -> int:
        """Number of corrupted packets until now."""

    def answers(self, servo_id: int, patience_s: float) -> bool:
        """Whether a servo has this identity; one request."""

    def look(self, servo_id: int, patience_s: float) -> Found:
        """The state of a servo that answers; nothing is written to it."""

    def servo(self, servo_id: int) -> BusServo:
        """Model and scale of a servo.

        Raises:
            Stopped: If it does not answer.
            InputError: If its model is unknown, or it does not control its position.
        """

    def settings(self, servo_id: int) -> dict[str, Any]:
        """Settings of a servo, for the recording: firmware, gains, profile, delays."""

    def saved(self, servo_id: int) -> dict[str, int]:
        """Values that ``begin`` changes and ``restore`` restores, as they are now.

        Raises:
            Stopped: If the servo does not answer.
        """

    def reading(self, servo_id: int) -> Reading:
        """Position and temperature of a servo that must answer.

        Raises:
            Stopped: If it does not answer.
        """

    def begin(self, goals: Mapping[int, int]) -> None:
        """Hold these set-points (ticks by identity) with the torque on, without motion profile.

        Raises:
            Stopped: If a servo does not confirm it.
        """

    def cycle(self, goals: Mapping[int, int], deadline: float) -> Cycle:
        """Send set-points (ticks by identity) and read every servo.

        Args:
            goals: Set-point of each servo, in ticks, by identity.
            deadline: Time limit of the whole round, by ``time.monotonic``.
        """

    def restore(self, servo_id: int, saved: Mapping[str, int]) -> bool:
        """Stop a servo, switch its torque off and restore what ``begin`` changed.

        Returns:
            Whether the servo confirmed all of it.
        """

    def cycle_s(self, count: int) -> float:
        """Time on the wire of a cycle with so many servos."""

    def sample_delay_s(self, count: int) -> float:
        """Time from the arrival of set-points to the sampling of positions, of so many servos."""

    def close(self) -> None:
        """Close the port."""


def mean_known(values: Sequence[float]) -> float:
    """Mean of the values that are not NaN; NaN if there are none."""
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan
