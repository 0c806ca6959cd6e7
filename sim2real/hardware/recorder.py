"""A recording from beginning to end: motion to the start, set-points and rows, release."""

import csv
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from tqdm import tqdm

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.hardware.buses import Bus, Changed, Connection
from sim2real.hardware.mounting import Mounting, Place
from sim2real.hardware.servo_bus import Cycle, Stopped, reason
from sim2real.output import check_writable, is_stream, write_json
from sim2real.robot import Robot
from sim2real.signals import Excitation

RATE_HZ = 50.0
APPROACH_RAD_S = 0.5
LARGEST_JUMP_RAD = 0.1
CONTACT_S = 0.5
"""Time without an answer after which a servo is regarded as lost."""
BUSY_SHARE = 0.8
"""Share of the period after which a reply counts as missing."""
FEWEST_ROWS = 2  # of a valid recording
SIGNED = ("velocity_rad_s", "current_A", "load")
"""Quantities that change their sign with the direction of the servo."""


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


@dataclass
class Run:
    """What became of a recording.

    ``missing`` and ``lost`` count, by joint, missing positions and set-points that did not take
    effect, where the servo tells; ``skipped`` counts set-points left out because the computer was
    late, ``late_s`` are the delays of the cycles. ``stopped`` is the reason of an early end; the
    torque of servos that are ``unreleased`` may still be on.
    """

    mountings: Sequence[Mounting]
    rows: int = 0
    missing: dict[str, int] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    skipped: int = 0
    late_s: list[float] = field(default_factory=list)
    stopped: str | None = None
    unreleased: Sequence[Mounting] = ()

    def __post_init__(self) -> None:
        self.missing = {mounting.joint.name: 0 for mounting in self.mountings}
        self.lost = dict(self.missing)

    @property
    def torque(self) -> str:
        """State of the servos, for a message."""
        if not self.unreleased:
            return "torque off"
        every = len(self.unreleased) == len(self.mountings)
        names = ", ".join(mounting.joint.name for mounting in self.unreleased)
        where = "any servo" if every else names
        return f"the torque of {where} may still be on: switch off the supply"

    def written(self, out: Path) -> str:
        """What is written, for a message."""
        return f"{self.rows} rows in {out}" if self.rows >= FEWEST_ROWS else "nothing written"

    @property
    def late_999_s(self) -> float:
        """Delay that 99.9 % of the cycles did not exceed, in s."""
        return float(np.quantile(self.late_s, 0.999)) if self.late_s else 0.0

    def summary(self) -> dict[str, Any]:
        """The outcome, for the recording's JSON."""
        return {
            "rows": self.rows,
            "missing_positions": self.missing,
            "lost_set_points": self.lost,
            "skipped_set_points": self.skipped,
            "late_999_s": round(self.late_999_s, 6),
            "stopped": self.stopped,
        }


@contextmanager
def row_file(
    path: Path, sidecar: dict[str, Any]
) -> Iterator[Callable[[Mapping[str, float]], None]]:
    """Context manager of ``NAME.csv`` and ``NAME.json``, valid after every row from the second on.

    It gives a function that appends a row, by column, and flushes it; NaN is an empty cell. The
    sidecar is written before the first row, and again at the end. Files with fewer than two rows
    are removed. ``InputError`` if the folder cannot be written, ``Stopped`` if a row cannot.
    """
    check_writable(path)
    if is_stream(path):
        raise InputError(path, "", "a device or a pipe", "a file, to write row by row")
    rows = 0
    write_json(path.with_suffix(".json"), sidecar)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")

        def write(row: Mapping[str, float]) -> None:
            nonlocal rows
            try:
                if rows == 0:
                    writer.writerow(row)
                writer.writerow("" if math.isnan(x) else f"{x:.6f}" for x in row.values())
                file.flush()
            except OSError as error:
                raise Stopped(f"{path} can't be written ({error.strerror})") from None
            rows += 1

        try:
            yield write
        finally:
            if rows < FEWEST_ROWS:
                path.unlink()
                path.with_suffix(".json").unlink()
            else:
                write_json(path.with_suffix(".json"), sidecar)


def record(
    run: Run,
    bus: Bus,
    command: Array,
    write: Callable[[Mapping[str, float]], object],
    *,
    hottest_C: float,
    interrupted: Callable[[], bool] = lambda: False,
    progress: Callable[[int], object] = lambda _: None,
) -> None:
    """Send the set-points (T, J) in rad at ``RATE_HZ`` and write one row for each.

    Cycle k starts k periods after the first, regardless of the previous cycles. Where a servo
    reports the set-point in effect, that is recorded: a set-point that was lost on the way did not
    change it. The outcome is in ``run``, whose servos are at rest on their first set-point; a lost
    port or servo, heat or an interrupt stops it. ``progress`` is called with the number of
    set-points since its last call.
    """
    period = 1 / RATE_HZ
    start = time.monotonic() + period
    answered_s = dict.fromkeys(run.missing, start)
    k = 0
    try:
        while k < len(command):
            due = start + k * period
            time.sleep(max(due - time.monotonic(), 0.0))
            if interrupted():
                raise Stopped("interrupted")
            run.late_s.append(time.monotonic() - due)
            pairs = zip(run.mountings, command[k], strict=True)
            goals = {mounting.servo_id: mounting.ticks(float(angle)) for mounting, angle in pairs}
            cycle = bus.cycle(goals, due + BUSY_SHARE * period)
            write(_row(cycle, goals, start, run.mountings))
            run.rows += 1
            for mounting, reading in zip(run.mountings, cycle.readings, strict=True):
                name = mounting.joint.name
                if reading.position_ticks is not None:
                    answered_s[name] = cycle.sent_s
                else:
                    run.missing[name] += 1
                    if cycle.sent_s - answered_s[name] > CONTACT_S:
                        raise Stopped(f"no reply from {name}'s servo for {CONTACT_S:g} s")
                run.lost[name] += reading.goal_ticks not in (None, goals[mounting.servo_id])
                mounting.check_temperature(reading.temperature_C, hottest_C)
            after = max(k + 1, math.ceil((time.monotonic() - start) / period - 0.5))
            run.skipped += min(after, len(command)) - (k + 1)
            progress(after - k)
            k = after
    except (Stopped, OSError) as error:
        run.stopped = reason(error)


def _row(
    cycle: Cycle, goals: dict[int, int], start: float, mountings: Sequence[Mounting]
) -> dict[str, float]:
    """The cells of a row, by column."""
    row, position, more = {"t_s": cycle.sent_s - start}, {}, {}
    for mounting, reading in zip(mountings, cycle.readings, strict=True):
        name, ticks = mounting.joint.name, reading.position_ticks
        goal = goals[mounting.servo_id] if reading.goal_ticks is None else reading.goal_ticks
        row[f"{name}.command_rad"] = mounting.angle(goal)
        position[f"{name}.position_rad"] = math.nan if ticks is None else mounting.angle(ticks)
        for quantity in mounting.servo.quantities:
            sign = mounting.sign if quantity in SIGNED else 1
            more[f"{name}.{quantity}"] = sign * getattr(reading, quantity)
    supplies = [r.supply_V for r in cycle.readings if not math.isnan(r.supply_V)]
    more["supply_V"] = sum(supplies) / len(supplies) if supplies else math.nan
    more |= {"round_trip_s": cycle.round_trip_s, "device_t_s": cycle.device_s}
    return row | position | more


def mounted(bus: Bus, robot: Robot, servos: Sequence[Place]) -> tuple[Mounting, ...]:
    """The servos in their joints, with the scales that they report.

    ``Stopped`` if a servo does not answer, ``InputError`` if its model is unknown, it does not
    control its position or does not fit its joint, or if the rate of the bus is too slow.
    """
    mountings = tuple(Mounting(**vars(one), servo=bus.servo(one.servo_id)) for one in servos)
    for mounting in mountings:
        joint, servo = mounting.joint, mounting.servo
        ends = [mounting.angle(servo.lowest_ticks), mounting.angle(servo.largest_ticks)]
        low, high = joint.limits_rad
        if low < min(ends) or high > max(ends):
            limits = f"{low:g} to {high:g} rad for {joint.name}"
            expected = f"limits that the servo reaches, {min(ends):.3f} to {max(ends):.3f} rad"
            raise InputError(robot.path or robot.name, "joints.limits_rad", limits, expected)
    takes, longest = bus.cycle_s(len(mountings)), BUSY_SHARE / RATE_HZ
    if takes > longest:
        found = f"{bus.baud} baud, {1e3 * takes:.1f} ms to address {len(mountings)} servos"
        raise InputError("--baud", "", found, f"at most {1e3 * longest:.0f} ms: a faster rate")
    return mountings


def drive(
    connection: Connection,
    robot: Robot,
    servos: Sequence[Place],
    played: Excitation,
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
    bus, mountings = connection.bus, mounted(connection.bus, robot, servos)
    ids = [mounting.servo_id for mounting in mountings]
    sidecar["bus"] = {
        "name": bus.name,
        "port": connection.port,
        "baud": bus.baud,
        "ids": ids,
        "trim_ticks": [mounting.trim_ticks for mounting in mountings],
        "sign": [mounting.sign for mounting in mountings],
        "servos": [bus.settings(servo_id) for servo_id in ids],
    }
    delay = round(bus.sample_delay_s(len(mountings)), 6)
    sidecar["context"] = {**sidecar.get("context", {}), "sample_delay_s": delay}
    run, changed = Run(mountings), list[Changed]()
    with interruption() as interrupted:
        limits: dict[str, Any] = {"hottest_C": hottest_C, "interrupted": interrupted}
        try:
            changed = connection.note(ids)
            approach(bus, mountings, [float(angle) for angle in played.command[0]], **limits)
            sidecar["started"] = datetime.now(UTC).isoformat(timespec="milliseconds")
            bar = tqdm(total=played.t.size, desc="record", unit="row", disable=None)
            with row_file(out, sidecar) as write, bar:
                record(run, bus, played.command, write, progress=bar.update, **limits)
                sidecar["outcome"] = run.summary()
        except (Stopped, OSError) as error:
            run.stopped = reason(error)
        finally:
            left = connection.release(changed, ids)
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
        ticks, servo = reading.position_ticks, mounting.servo
        if abs(mounting.within(ticks) - ticks) * servo.tick_rad > LARGEST_JUMP_RAD:
            ends = f"{servo.lowest_ticks} to {servo.largest_ticks} ticks"
            found = f"{mounting.joint.name}'s servo is at {ticks} ticks"
            raise Stopped(f"{found}, outside its range of {ends}: turn it by hand")
        start[mounting.servo_id] = ticks
        ways[mounting.servo_id] = mounting.ticks(angle) - ticks

    def goals(share: float) -> dict[int, int]:
        ids = {m.servo_id: m for m in mountings}
        return {k: m.within(start[k] + round(share * ways[k])) for k, m in ids.items()}

    bus.begin(goals(0.0))
    fastest = APPROACH_RAD_S / min(mounting.servo.tick_rad for mounting in mountings)
    longest = max(abs(way) for way in ways.values()) / fastest
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < longest + settle_s:
        if interrupted():
            raise Stopped("interrupted")
        bus.cycle(goals(min(now / longest, 1.0) if longest else 1.0), time.monotonic() + period_s)
        time.sleep(max(begin + now + period_s - time.monotonic(), 0.0))
