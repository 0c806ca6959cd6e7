"""Motion of the servos before and after a recording: approach of the start, release."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence

from sim2real.hardware.bus import Bus
from sim2real.hardware.lx import BusCommand, Packet, load, move, signed_word
from sim2real.hardware.mounting import Mounting

SPEED_RAD_S = 0.5
SETTLE_S = 0.5
PATIENCE_S = 0.03
ATTEMPTS = 10


class Stopped(Exception):
    """The servos must not be driven any further; the message is the reason."""


def approach(
    bus: Bus,
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
        Stopped: If a servo does not answer or is too hot, or the user has asked to stop.
        OSError: If the port is lost.
    """
    longest = 0.0
    for mounting, angle in zip(mountings, target, strict=True):
        temperature = _insist(bus, mounting, BusCommand.TEMP_READ).parameters[0]
        check_temperature(mounting, temperature, hottest_C)
        ticks = signed_word(_insist(bus, mounting, BusCommand.POS_READ))
        duration = abs(mounting.angle(ticks) - angle) / SPEED_RAD_S
        longest = max(longest, duration)
        go = move(mounting.servo_id, mounting.ticks(angle), round(1000 * min(duration, 30.0)))
        switch_on(bus, mounting)
        for _ in range(3):  # the first that arrives counts
            bus.exchange([go], time.monotonic())
            time.sleep(0.005)
    until = time.monotonic() + longest + SETTLE_S
    while time.monotonic() < until:
        if interrupted():
            raise Stopped("interrupted")
        time.sleep(0.02)


def switch_on(bus: Bus, mounting: Mounting) -> None:
    """Switch the torque of a servo on, and check it.

    Raises:
        Stopped: If it does not confirm.
    """
    if not _set_load(bus, mounting, on=True):
        raise Stopped(f"{mounting.joint.name}'s servo {mounting.servo_id} does not switch on")


def release(bus: Bus, mountings: Sequence[Mounting]) -> list[str]:
    """Stop every servo and switch its torque off.

    Returns:
        Names of the joints whose servo did not confirm it; their torque may still be on.
    """
    unconfirmed = []
    for mounting in mountings:
        with contextlib.suppress(OSError):
            bus.drain()
            bus.exchange([Packet(mounting.servo_id, BusCommand.MOVE_STOP)], time.monotonic())
            if _set_load(bus, mounting, on=False):
                continue
        unconfirmed.append(mounting.joint.name)
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


def _set_load(bus: Bus, mounting: Mounting, *, on: bool) -> bool:
    for _ in range(ATTEMPTS):
        request = [load(mounting.servo_id, on), Packet(mounting.servo_id, BusCommand.LOAD_READ)]
        reply = bus.exchange(request, time.monotonic() + PATIENCE_S)[1]
        if reply is not None and bool(reply.parameters[0]) == on:
            return True
    return False


def _insist(bus: Bus, mounting: Mounting, command: BusCommand) -> Packet:
    for _ in range(ATTEMPTS):
        reply = bus.ask(mounting.servo_id, command, PATIENCE_S)
        if reply is not None:
            return reply
    raise Stopped(f"no reply from {mounting.joint.name}'s servo {mounting.servo_id}")
