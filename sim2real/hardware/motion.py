"""Motion of the servos before and after a recording: approach of the start, release."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence

from sim2real.hardware.mounting import Mounting
from sim2real.hardware.servo_bus import ServoBus, Stopped

SPEED_RAD_S = 0.5
SETTLE_S = 0.5
PERIOD_S = 0.02
LARGEST_JUMP_RAD = 0.1
ATTEMPTS = 2
"""Attempts to release a servo, each of which insists."""


def approach(
    bus: ServoBus,
    mountings: Sequence[Mounting],
    target: Sequence[float],
    *,
    hottest_C: float,
    interrupted: Callable[[], bool] = lambda: False,
) -> None:
    """Move every joint slowly to its first set-point, and wait until it is at rest.

    Args:
        bus: The bus.
        mountings: The J servos.
        target: Set-points in rad, shape (J,).
        hottest_C: Temperature above which a servo is not switched on.
        interrupted: Whether the user has asked to stop.

    Raises:
        Stopped: If a servo does not answer, is too hot or outside of its range, or the user has
            asked to stop.
        OSError: If the port is lost.
    """
    start, ways = {}, {}
    for mounting, angle in zip(mountings, target, strict=True):
        reading = bus.reading(mounting.servo_id)
        check_temperature(mounting, reading.temperature_C, hottest_C)
        assert reading.position_ticks is not None
        _check_range(mounting, reading.position_ticks)
        start[mounting.servo_id] = reading.position_ticks
        ways[mounting.servo_id] = mounting.ticks(angle) - reading.position_ticks
    bus.begin({m.servo_id: m.within(start[m.servo_id]) for m in mountings})
    fastest = SPEED_RAD_S / min(mounting.scale.tick_rad for mounting in mountings)
    longest = max(abs(way) for way in ways.values()) / fastest
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < longest + SETTLE_S:
        if interrupted():
            raise Stopped("interrupted")
        share = min(now / longest, 1.0) if longest else 1.0
        goals = {
            m.servo_id: m.within(start[m.servo_id] + round(share * ways[m.servo_id]))
            for m in mountings
        }
        bus.cycle(goals, time.monotonic() + PERIOD_S)
        time.sleep(max(begin + now + PERIOD_S - time.monotonic(), 0.0))


def release(bus: ServoBus, changed: Mapping[int, Mapping[str, int]]) -> list[int]:
    """Stop every servo, switch its torque off and restore its limits.

    Args:
        bus: The bus.
        changed: For each identity the values to restore.

    Returns:
        Identities of those that did not confirm it; their torque may still be on.
    """
    unconfirmed = []
    for servo_id, values in changed.items():
        with contextlib.suppress(OSError):
            if any(bus.restore(servo_id, values) for _ in range(ATTEMPTS)):
                continue
        unconfirmed.append(servo_id)
    return unconfirmed


def check_temperature(mounting: Mounting, temperature_C: float, hottest_C: float) -> None:
    """Check that a servo is not too hot.

    Raises:
        Stopped: If it is.
    """
    if temperature_C > hottest_C:
        raise Stopped(
            f"{mounting.joint.name}'s servo is at {temperature_C:.0f} C, above {hottest_C:.0f} C"
        )


def _check_range(mounting: Mounting, ticks: int) -> None:
    """Check that a servo can be held where it is: outside its range it would jump to the end."""
    if abs(mounting.within(ticks) - ticks) * mounting.scale.tick_rad > LARGEST_JUMP_RAD:
        ends = f"{mounting.scale.lowest_ticks} to {mounting.scale.largest_ticks} ticks"
        raise Stopped(
            f"{mounting.joint.name}'s servo is at {ticks} ticks, outside its range of {ends}: turn "
            "it by hand"
        )
