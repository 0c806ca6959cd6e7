"""The loop that sends set-points to the servos and records their positions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Self

from sim2real.arrays import Array
from sim2real.hardware.motion import check_temperature
from sim2real.hardware.mounting import Mounting
from sim2real.hardware.servo_bus import Cycle, ServoBus, Stopped, mean_known

CONTACT_S = 0.5
"""Time without an answer after which a servo is regarded as lost."""
BUSY_SHARE = 0.8
"""Share of the period after which a reply counts as missing."""
SIGNED = ("velocity_rad_s", "current_A", "load")
"""Quantities that change their sign with the direction of the servo."""


@dataclass
class Outcome:
    """Outcome of a recording.

    Attributes:
        missing: Number of missing positions by joint.
        lost: Number of set-points by joint that did not take effect, where the servo tells.
        skipped: Set-points that were skipped because the computer was late.
        late_s: Delay of each row's cycle, in s.
        stopped: Reason of an early end; None if there was none.
    """

    missing: dict[str, int]
    lost: dict[str, int]
    skipped: int = 0
    late_s: list[float] = field(default_factory=list)
    stopped: str | None = None

    @classmethod
    def of(cls, mountings: Sequence[Mounting]) -> Self:
        """An outcome of these servos, before the first cycle."""
        names = [mounting.joint.name for mounting in mountings]
        return cls(dict.fromkeys(names, 0), dict.fromkeys(names, 0))


def columns(mountings: Sequence[Mounting]) -> list[str]:
    """The header of the recording."""
    names = [mounting.joint.name for mounting in mountings]
    return [
        "t_s",
        *(f"{name}.command_rad" for name in names),
        *(f"{name}.position_rad" for name in names),
        *(f"{m.joint.name}.{quantity}" for m in mountings for quantity in m.servo.quantities),
        "supply_V",
        "round_trip_s",
        "device_t_s",
    ]


def record(
    bus: ServoBus,
    mountings: Sequence[Mounting],
    command: Array,
    write: Callable[[Sequence[float]], None],
    *,
    rate_hz: float,
    hottest_C: float,
    interrupted: Callable[[], bool] = lambda: False,
    progress: Callable[[int], object] = lambda _: None,
) -> Outcome:
    """Send the set-points at a regular rate and write one row for each.

    Cycle k starts k periods after the first, regardless of the previous cycles. Where a servo
    reports the set-point in effect, that is recorded: a set-point that was lost on the way did not
    change it.

    Args:
        bus: The bus.
        mountings: The J servos, at rest on their first set-point.
        command: Set-points in rad, shape (T, J).
        write: Called with each row, in the order of ``columns``.
        rate_hz: Set-points per second.
        hottest_C: Temperature at which to stop.
        interrupted: Whether the user has asked to stop; called once per cycle.
        progress: Called with the number of set-points since its last call.

    Returns:
        The outcome; ``stopped`` is set for a lost port or servo, heat, or an interrupt.
    """
    outcome = Outcome.of(mountings)
    period = 1 / rate_hz
    start = time.monotonic() + period
    answered_s = [start] * len(mountings)
    k = 0
    try:
        while k < len(command):
            due = start + k * period
            time.sleep(max(due - time.monotonic(), 0.0))
            if interrupted():
                raise Stopped("interrupted")
            outcome.late_s.append(time.monotonic() - due)
            pairs = zip(mountings, command[k], strict=True)
            goals = {mounting.servo_id: mounting.ticks(float(angle)) for mounting, angle in pairs}
            cycle = bus.cycle(goals, due + BUSY_SHARE * period)
            write(_row(cycle, goals, start, mountings))
            _check(cycle, goals, mountings, answered_s, outcome, hottest_C)
            after = max(k + 1, math.ceil((time.monotonic() - start) / period - 0.5))
            outcome.skipped += min(after, len(command)) - (k + 1)
            progress(after - k)
            k = after
    except Stopped as stop:
        outcome.stopped = str(stop)
    except OSError as error:
        outcome.stopped = f"the port was lost ({error.strerror or error})"
    return outcome


def _row(
    cycle: Cycle, goals: dict[int, int], start: float, mountings: Sequence[Mounting]
) -> list[float]:
    """The cells of a row, in the order of ``columns``."""
    pairs = list(zip(mountings, cycle.readings, strict=True))
    held = [goals[m.servo_id] if r.goal_ticks is None else r.goal_ticks for m, r in pairs]
    return [
        cycle.sent_s - start,
        *(m.angle(ticks) for m, ticks in zip(mountings, held, strict=True)),
        *(math.nan if r.position_ticks is None else m.angle(r.position_ticks) for m, r in pairs),
        *(
            m.sign * getattr(r, name) if name in SIGNED else getattr(r, name)
            for m, r in pairs
            for name in m.servo.quantities
        ),
        mean_known([reading.supply_V for reading in cycle.readings]),
        cycle.round_trip_s,
        cycle.device_s,
    ]


def _check(
    cycle: Cycle,
    goals: dict[int, int],
    mountings: Sequence[Mounting],
    answered_s: list[float],
    outcome: Outcome,
    hottest_C: float,
) -> None:
    """Count what is missing, and stop if a servo is lost or too hot."""
    for j, (mounting, reading) in enumerate(zip(mountings, cycle.readings, strict=True)):
        name = mounting.joint.name
        if reading.position_ticks is not None:
            answered_s[j] = cycle.sent_s
        else:
            outcome.missing[name] += 1
            if cycle.sent_s - answered_s[j] > CONTACT_S:
                raise Stopped(f"no reply from {name}'s servo for {CONTACT_S:g} s")
        outcome.lost[name] += reading.goal_ticks not in (None, goals[mounting.servo_id])
        if not math.isnan(reading.temperature_C):
            check_temperature(mounting, reading.temperature_C, hottest_C)
