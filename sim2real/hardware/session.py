"""A recording from beginning to end: servos in their joints, motion to the start, release."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.hardware.buses import Bus, Changed, Connection
from sim2real.hardware.mounting import Mounting, Wiring, mount
from sim2real.hardware.recorder import BUSY_SHARE, Run, columns, record, row_file
from sim2real.hardware.servo_bus import Stopped, reason
from sim2real.robot import Robot
from sim2real.signals import Excitation


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Context manager of a function: whether a signal, in the main thread, asks to stop."""
    asked = threading.Event()

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()

    names = ("SIGINT", "SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    before = [(number, signal.signal(number, ask)) for number in numbers]
    try:
        yield asked.is_set
    finally:
        for number, handler in before:
            signal.signal(number, handler)


@contextmanager
def priority() -> Iterator[None]:
    """Context manager that gives the calling thread real-time priority, where it is permitted.

    The bus is then in time on a loaded computer. Linux requires root or a limit on ``rtprio``.
    """
    granted = False
    if sys.platform == "linux":
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
            granted = True
    try:
        yield
    finally:
        if granted:
            os.sched_setscheduler(0, *before)


RATE_HZ = 50.0
APPROACH_RAD_S = 0.5
LARGEST_JUMP_RAD = 0.1


def mounted(bus: Bus, robot: Robot, wiring: Wiring) -> tuple[Mounting, ...]:
    """The servos in their joints, with the scales that they report.

    ``Stopped`` if a servo does not answer, ``InputError`` if its model is unknown, it does not
    control its position or does not fit its joint, or if the rate of the bus is too slow.
    """
    mountings = mount(robot, [bus.servo(servo_id) for servo_id in wiring.ids], wiring)
    takes, longest = bus.cycle_s(len(mountings)), BUSY_SHARE / RATE_HZ
    if takes > longest:
        found = f"{bus.baud} baud, {1e3 * takes:.1f} ms to address {len(mountings)} servos"
        raise InputError("--baud", "", found, f"at most {1e3 * longest:.0f} ms: a faster rate")
    return mountings


def drive(
    connection: Connection,
    robot: Robot,
    wiring: Wiring,
    signal: Excitation,
    out: Path,
    sidecar: dict[str, Any],
    *,
    hottest_C: float,
) -> Run:
    """Move to the start, record, and release the servos in any case.

    What is changed in the servos is noted in the port's journal before, so that after a kill the
    next command on the port restores it. Port, wiring, settings of the servos and the outcome are
    added to ``sidecar``, which is written beside ``out``. ``InputError`` and ``Stopped`` before
    anything is changed, as of ``mounted``.
    """
    bus, mountings = connection.bus, mounted(connection.bus, robot, wiring)
    sidecar["bus"] = {
        "name": bus.name,
        "port": connection.port,
        "baud": bus.baud,
        "ids": [mounting.servo_id for mounting in mountings],
        "trim_ticks": [mounting.trim_ticks for mounting in mountings],
        "sign": [mounting.sign for mounting in mountings],
        "servos": [bus.settings(mounting.servo_id) for mounting in mountings],
    }
    delay = round(bus.sample_delay_s(len(mountings)), 6)
    sidecar["context"] = {**sidecar.get("context", {}), "sample_delay_s": delay}
    run, changed = Run(mountings), list[Changed]()
    with interruption() as interrupted:
        limits: dict[str, Any] = {"hottest_C": hottest_C, "interrupted": interrupted}
        try:
            changed = connection.note(wiring.ids)
            approach(bus, mountings, [float(angle) for angle in signal.command[0]], **limits)
            sidecar["started"] = datetime.now(UTC).isoformat(timespec="milliseconds")
            bar = tqdm(total=signal.t.size, desc="record", unit="row", disable=None)
            with row_file(out, columns(mountings), sidecar) as write, bar:
                limits |= {"rate_hz": RATE_HZ, "progress": bar.update}
                record(run, bus, signal.command, write, **limits)
                sidecar["outcome"] = run.summary()
        except (Stopped, OSError) as error:
            run.stopped = reason(error)
        finally:
            left = connection.release(changed, wiring.ids)
            run.unreleased = [mounting for mounting in mountings if mounting.servo_id in left]
    return run


def approach(
    bus: Bus,
    mountings: Sequence[Mounting],
    target: Sequence[float],
    *,
    hottest_C: float,
    interrupted: Callable[[], bool],
    settle_s: float = 0.5,
    period_s: float = 0.02,
) -> None:
    """Move every joint slowly to its first set-point in rad, and wait until it is at rest.

    ``Stopped`` if a servo does not answer, is above ``hottest_C`` or outside of its range, to whose
    end it would jump, or the user has asked to stop; ``OSError`` if the port is lost.
    """
    start, ways = {}, {}
    for mounting, angle in zip(mountings, target, strict=True):
        reading = bus.reading(mounting.servo_id)
        mounting.check_temperature(reading.temperature_C, hottest_C)
        assert reading.position_ticks is not None
        ticks, scale = reading.position_ticks, mounting.servo.scale
        if abs(mounting.within(ticks) - ticks) * scale.tick_rad > LARGEST_JUMP_RAD:
            ends = f"{scale.lowest_ticks} to {scale.largest_ticks} ticks"
            found = f"{mounting.joint.name}'s servo is at {ticks} ticks"
            raise Stopped(f"{found}, outside its range of {ends}: turn it by hand")
        start[mounting.servo_id] = ticks
        ways[mounting.servo_id] = mounting.ticks(angle) - ticks

    def goals(share: float) -> dict[int, int]:
        ids = {m.servo_id: m for m in mountings}
        return {k: m.within(start[k] + round(share * ways[k])) for k, m in ids.items()}

    bus.begin(goals(0.0))
    fastest = APPROACH_RAD_S / min(mounting.servo.scale.tick_rad for mounting in mountings)
    longest = max(abs(way) for way in ways.values()) / fastest
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < longest + settle_s:
        if interrupted():
            raise Stopped("interrupted")
        bus.cycle(goals(min(now / longest, 1.0) if longest else 1.0), time.monotonic() + period_s)
        time.sleep(max(begin + now + period_s - time.monotonic(), 0.0))
