"""The loop that sends set-points to the servos and records their positions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from sim2real.arrays import Array
from sim2real.hardware.bus import Bus
from sim2real.hardware.lx import BusCommand, Packet, move, signed_word, supply_V
from sim2real.hardware.motion import Stopped, check_temperature
from sim2real.hardware.mounting import Mounting

CONTACT_S = 0.5
"""Time without an answer after which a servo is regarded as lost."""
BUSY_SHARE = 0.8
"""Share of the period after which a reply counts as missing."""


@dataclass
class Outcome:
    """Outcome of a recording.

    Attributes:
        missing: Number of missing positions by joint.
        skipped: Set-points that were skipped because the computer was late.
        late_s: Delay of each row's cycle, in s.
        stopped: Reason of an early end; None if there was none.
    """

    missing: dict[str, int]
    skipped: int = 0
    late_s: list[float] = field(default_factory=list)
    stopped: str | None = None


USUAL_S = 0.0025
"""Typical time of a servo's set-point, request and reply on the wire, with the adapter."""


def columns(mountings: Sequence[Mounting]) -> list[str]:
    """The header of the recording."""
    names = [mounting.joint.name for mounting in mountings]
    return [
        "t_s",
        *(f"{name}.command_rad" for name in names),
        *(f"{name}.position_rad" for name in names),
        *(f"{name}.temperature_C" for name in names),
        "supply_V",
        "round_trip_s",
        "device_t_s",
    ]


def record(
    bus: Bus,
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

    Cycle k starts k periods after the first, regardless of the previous cycles. The position of
    each servo is requested directly after its set-point, so that both have the same time; then one
    servo in turn reports its supply or temperature.

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
    outcome = Outcome({mounting.joint.name: 0 for mounting in mountings})
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
            ask = _health_request(mountings, len(outcome.late_s) - 1)
            sample = _cycle(bus, mountings, command[k], ask, due + BUSY_SHARE * period)
            write(_row(sample, start, len(mountings), ask))
            _check(mountings, sample, ask, answered_s, outcome, hottest_C)
            after = max(k + 1, math.ceil((time.monotonic() - start) / period - 0.5))
            outcome.skipped += min(after, len(command)) - (k + 1)
            progress(after - k)
            k = after
    except Stopped as stop:
        outcome.stopped = str(stop)
    except OSError as error:
        outcome.stopped = f"the port was lost ({error.strerror or error})"
    return outcome


@dataclass(frozen=True)
class _Sample:
    """Set-points and replies of one cycle."""

    sent_s: float
    command: list[float]
    position: list[float]
    health: float
    round_trip_s: float
    device_s: float


def _health_request(mountings: Sequence[Mounting], cycle: int) -> tuple[int, BusCommand]:
    """Servo and quantity reported in a cycle: supply, then temperature, of each in turn."""
    j = cycle // 2 % len(mountings)
    return j, BusCommand.TEMP_READ if cycle % 2 else BusCommand.VIN_READ


def _cycle(
    bus: Bus,
    mountings: Sequence[Mounting],
    command: Array,
    ask: tuple[int, BusCommand],
    deadline: float,
) -> _Sample:
    """One round over the bus; a servo may take the time that the later ones do not need."""
    bus.drain()
    ticks = [m.ticks(float(angle)) for m, angle in zip(mountings, command, strict=True)]
    groups = [
        [move(m.servo_id, goal), Packet(m.servo_id, BusCommand.POS_READ)]
        for m, goal in zip(mountings, ticks, strict=True)
    ]
    groups.append([Packet(mountings[ask[0]].servo_id, ask[1])])
    if bus.together:
        groups = [[packet for group in groups for packet in group]]
    replies: list[Packet | None] = []
    sent, round_trips = [], []
    for after, group in zip(reversed(range(len(groups))), groups, strict=True):
        sent.append(time.monotonic())
        remaining = deadline - sent[-1]
        received = bus.exchange(
            group, sent[-1] + max(remaining - after * USUAL_S, remaining / (after + 1))
        )
        if received[-1] is not None:
            round_trips.append(time.monotonic() - sent[-1])
        replies += received
    joints = max(len(groups) - 1, 1)  # the last group of several is the health request
    health = replies[-1]
    return _Sample(
        sent_s=sum(sent[:joints]) / joints,
        command=[m.angle(goal) for m, goal in zip(mountings, ticks, strict=True)],
        position=[
            math.nan if reply is None else m.angle(signed_word(reply))
            for m, reply in zip(mountings, replies[1::2], strict=False)
        ],
        health=math.nan if health is None else _health(ask[1], health),
        round_trip_s=max(round_trips, default=math.nan),
        device_s=math.nan if bus.device_s is None or not round_trips else bus.device_s,
    )


def _health(command: BusCommand, reply: Packet) -> float:
    return supply_V(reply) if command == BusCommand.VIN_READ else float(reply.parameters[0])


def _row(sample: _Sample, start: float, J: int, ask: tuple[int, BusCommand]) -> list[float]:
    temperature, supply = [math.nan] * J, math.nan
    if ask[1] == BusCommand.TEMP_READ:
        temperature[ask[0]] = sample.health
    else:
        supply = sample.health
    return [
        sample.sent_s - start,
        *sample.command,
        *sample.position,
        *temperature,
        supply,
        sample.round_trip_s,
        sample.device_s,
    ]


def _check(
    mountings: Sequence[Mounting],
    sample: _Sample,
    ask: tuple[int, BusCommand],
    answered_s: list[float],
    outcome: Outcome,
    hottest_C: float,
) -> None:
    """Count missing positions, and stop if a servo is lost or too hot."""
    for j, mounting in enumerate(mountings):
        name = mounting.joint.name
        if not math.isnan(sample.position[j]):
            answered_s[j] = sample.sent_s
        else:
            outcome.missing[name] += 1
            if sample.sent_s - answered_s[j] > CONTACT_S:
                raise Stopped(f"no reply from {name}'s servo for {CONTACT_S:g} s")
    if ask[1] == BusCommand.TEMP_READ and not math.isnan(sample.health):
        check_temperature(mountings[ask[0]], sample.health, hottest_C)
