"""A recording from beginning to end: servos in their joints, motion to the start, release."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.hardware.buses import Connection
from sim2real.hardware.interruption import interruption
from sim2real.hardware.journal import Changed
from sim2real.hardware.motion import approach, release
from sim2real.hardware.mounting import Mounting, check_ids, check_joints, mount
from sim2real.hardware.recorder import BUSY_SHARE, Outcome, columns, record
from sim2real.hardware.row_stream import FEWEST_ROWS, RowStream
from sim2real.hardware.servo_bus import Stopped
from sim2real.robot import Robot
from sim2real.signals import Excitation

RATE_HZ = 50.0


@dataclass(frozen=True)
class Wiring:
    """Which servo is in which joint.

    Attributes:
        ids: Identity of the servo of each joint.
        joints: Names of the joints; None for all of the robot.
        trim_ticks: Trim of each servo; None for 0.
        reverse: Names of the joints whose servo turns in the opposite direction.
    """

    ids: Sequence[int]
    joints: Sequence[str] | None = None
    trim_ticks: Sequence[int] | None = None
    reverse: Sequence[str] | None = None

    def check(self, robot: Robot, largest_id: int) -> None:
        """Check it against the robot and the bus, before the port is opened.

        Raises:
            InputError: If numbers do not match, or a name or an identity is wrong.
        """
        check_joints(robot, len(self.ids), self.joints, self.trim_ticks, self.reverse)
        check_ids(self.ids, largest_id)


@dataclass(frozen=True)
class Run:
    """What became of a recording.

    Attributes:
        outcome: Outcome of the recording; ``stopped`` is the reason of an early end.
        rows: Number of rows.
        unreleased: Servos whose torque may still be on.
        servos: Number of servos.
    """

    outcome: Outcome
    rows: int
    unreleased: tuple[Mounting, ...]
    servos: int

    @property
    def torque(self) -> str:
        """State of the servos, for a message."""
        if not self.unreleased:
            return "torque off"
        every = len(self.unreleased) == self.servos
        names = ", ".join(mounting.joint.name for mounting in self.unreleased)
        where = "any servo" if every else names
        return f"the torque of {where} may still be on: switch off the supply"

    def written(self, out: Path) -> str:
        """What is written, for a message."""
        return f"{self.rows} rows in {out}" if self.rows >= FEWEST_ROWS else "nothing written"


def mounted(connection: Connection, robot: Robot, wiring: Wiring) -> tuple[Mounting, ...]:
    """The servos in their joints, with the scales that they report.

    Raises:
        Stopped: If a servo does not answer.
        InputError: If its model is unknown, it does not control its position, or it does not fit
            its joint; or if the rate of the bus is too slow.
    """
    servos = [connection.bus.servo(servo_id) for servo_id in wiring.ids]
    names, trims, reverse = wiring.joints, wiring.trim_ticks, wiring.reverse
    mountings = mount(robot, servos, joints=names, trim_ticks=trims, reverse=reverse)
    takes, longest = connection.bus.cycle_s(len(servos)), BUSY_SHARE / RATE_HZ
    if takes > longest:
        found = f"{connection.baud} baud, {1e3 * takes:.1f} ms to address {len(servos)} servos"
        raise InputError("--baud", "", found, f"at most {1e3 * longest:.0f} ms: a faster rate")
    return mountings


def bus_settings(
    connection: Connection, port: str, mountings: Sequence[Mounting]
) -> dict[str, Any]:
    """Port, wiring and settings of the servos, for a recording's JSON.

    Raises:
        Stopped: If a servo does not answer.
    """
    return {
        "name": connection.bus.name,
        "port": port,
        "baud": connection.baud,
        "ids": [mounting.servo_id for mounting in mountings],
        "trim_ticks": [mounting.trim_ticks for mounting in mountings],
        "sign": [mounting.sign for mounting in mountings],
        "servos": [connection.bus.settings(mounting.servo_id) for mounting in mountings],
    }


def drive(
    connection: Connection,
    mountings: Sequence[Mounting],
    signal: Excitation,
    out: Path,
    sidecar: dict[str, Any],
    *,
    hottest_C: float,
) -> Run:
    """Move to the start, record, and release the servos in any case.

    What is changed in the servos is noted in the port's journal before, so that after a kill the
    next command on the port restores it.

    Args:
        connection: The bus.
        mountings: The J servos.
        signal: Set-points, shape (T, J).
        out: The CSV file.
        sidecar: Content of its JSON file, to which the outcome is added.
        hottest_C: Temperature at which to stop.
    """
    bus, outcome, rows = connection.bus, Outcome.of(mountings), 0
    changed: list[Changed] = []
    delay = round(bus.sample_delay_s(len(mountings)), 6)
    sidecar["context"] = {**sidecar.get("context", {}), "sample_delay_s": delay}
    with interruption() as interrupted:
        try:
            changed = note_changes(connection, mountings)
            start = [float(angle) for angle in signal.command[0]]
            approach(bus, mountings, start, hottest_C=hottest_C, interrupted=interrupted)
            sidecar["started"] = datetime.now(UTC).isoformat(timespec="milliseconds")
            with (
                RowStream(out, columns(mountings), sidecar) as stream,
                tqdm(total=signal.t.size, desc="record", unit="row", disable=None) as bar,
            ):
                outcome = record(
                    bus,
                    mountings,
                    signal.command,
                    stream.write,
                    rate_hz=RATE_HZ,
                    hottest_C=hottest_C,
                    interrupted=interrupted,
                    progress=bar.update,
                )
                rows = stream.rows
                stream.add(outcome=_summary(outcome, rows))
        except Stopped as stop:
            outcome = replace(outcome, stopped=str(stop))
        except OSError as error:
            outcome = replace(outcome, stopped=f"the port was lost ({error.strerror or error})")
        finally:
            unreleased = let_go(connection, mountings, changed)
    return Run(outcome, rows, tuple(unreleased), len(mountings))


def note_changes(connection: Connection, mountings: Sequence[Mounting]) -> list[Changed]:
    """Note in the port's journal what is about to be changed in the servos.

    Raises:
        Stopped: If a servo does not answer.
        InputError: If the journal cannot be written.
    """
    bus, ids = connection.bus, [mounting.servo_id for mounting in mountings]
    before = [Changed(bus.name, connection.baud, k, bus.saved(k)) for k in ids]
    return connection.journal.note(before)


def let_go(
    connection: Connection, mountings: Sequence[Mounting], changed: Sequence[Changed]
) -> list[Mounting]:
    """Release all servos; those that are changed and do not confirm it stay in the journal.

    Returns:
        Servos whose torque may still be on.
    """
    values: dict[int, Mapping[str, int]] = {mounting.servo_id: {} for mounting in mountings}
    values |= {entry.servo_id: entry.values for entry in changed}
    left = release(connection.bus, values)
    connection.journal.forget([entry for entry in changed if entry.servo_id not in left])
    return [mounting for mounting in mountings if mounting.servo_id in left]


def _summary(outcome: Outcome, rows: int) -> dict[str, Any]:
    late = float(np.quantile(outcome.late_s, 0.999)) if outcome.late_s else 0.0
    return {
        "rows": rows,
        "missing_positions": outcome.missing,
        "lost_set_points": outcome.lost,
        "skipped_set_points": outcome.skipped,
        "late_999_s": round(late, 6),
        "stopped": outcome.stopped,
    }
