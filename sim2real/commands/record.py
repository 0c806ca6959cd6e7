"""``sim2real record``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.hardware.bus import Bus
from sim2real.hardware.interruption import interruption
from sim2real.hardware.motion import Stopped, approach, release
from sim2real.hardware.mounting import Mounting, mount
from sim2real.hardware.priority import priority
from sim2real.hardware.recorder import Outcome, columns, record
from sim2real.hardware.row_stream import FEWEST_ROWS, RowStream
from sim2real.hardware.transport import open_transport
from sim2real.output import check_writable, provenance
from sim2real.recording import SCHEMA
from sim2real.robot import Joint, Robot, read_robot
from sim2real.signals import UNIT, Excitation, Shape, excitation, played
from sim2real.structured import read_json

RATE_HZ = 50.0
_PLANNED = ("loads", "context", "rivals")
HOTTEST_POSSIBLE_C = 85.0  # where the servos switch off by themselves


def run(options: argparse.Namespace) -> int:
    """Play a signal on the servos of a bus and write the recording row by row.

    Returns:
        0 if all of it was recorded, 1 if it was stopped early; earlier rows are kept.
    """
    robot = read_robot(options.robot)
    joints = _joints(robot, options.joints)
    signal = _signal(options, joints)
    if options.dry_run:
        print(_described(signal, joints))
        _plot(options.plot, signal, joints)
        return 0
    mountings = _mountings(options, robot)
    sidecar = _sidecar(options, robot, signal, mountings)
    _check_out(options)
    _plot(options.plot, signal, joints)
    for note in signal.notes:
        print(note)
    with priority(), Bus(open_transport(options.port)) as bus:
        outcome, rows, unreleased = _drive(options, bus, mountings, signal, sidecar)
    return _report(options.out, outcome, rows, mountings, unreleased)


def _drive(
    options: argparse.Namespace,
    bus: Bus,
    mountings: Sequence[Mounting],
    signal: Excitation,
    sidecar: dict[str, Any],
) -> tuple[Outcome, int, list[str]]:
    """Move to the start, record, and release the servos in any case.

    Returns:
        The outcome, the number of rows, and the joints whose torque may still be on.
    """
    outcome, rows = Outcome({mounting.joint.name: 0 for mounting in mountings}), 0
    hottest = options.max_temperature
    with interruption() as interrupted:
        try:
            start = [float(angle) for angle in signal.command[0]]
            approach(bus, mountings, start, hottest_C=hottest, interrupted=interrupted)
            sidecar["started"] = datetime.now(UTC).isoformat(timespec="milliseconds")
            with (
                RowStream(options.out, columns(mountings), sidecar) as stream,
                tqdm(total=signal.t.size, desc="record", unit="row", disable=None) as bar,
            ):
                outcome = record(
                    bus,
                    mountings,
                    signal.command,
                    stream.write,
                    rate_hz=RATE_HZ,
                    hottest_C=hottest,
                    interrupted=interrupted,
                    progress=bar.update,
                )
                rows = stream.rows
                stream.add(outcome=_summary(outcome, rows))
        except Stopped as stop:
            outcome.stopped = str(stop)
        except OSError as error:
            outcome.stopped = f"the port was lost ({error.strerror or error})"
        finally:
            unreleased = release(bus, mountings)
    return outcome, rows, unreleased


def _sidecar(
    options: argparse.Namespace,
    robot: Robot,
    signal: Excitation,
    mountings: Sequence[Mounting],
) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "kind": "servo",
        "joints": list(signal.joints),
        **_planned(options.signal),
        **({"loads": _loads(options.inertia, signal.joints)} if options.inertia else {}),
        "medium": options.medium,
        "source": options.source or f"Recorded by 'sim2real record' on {robot.name}.",
        "signal": {"name": str(options.signal), "notes": list(signal.notes)},
        "bus": {
            "port": options.port,
            "ids": [mounting.servo_id for mounting in mountings],
            "trim_ticks": [mounting.trim_ticks for mounting in mountings],
            "sign": [mounting.sign for mounting in mountings],
        },
        "provenance": provenance([options.robot], options.seed),
    }


def _report(
    out: Path, outcome: Outcome, rows: int, mountings: Sequence[Mounting], unreleased: list[str]
) -> int:
    """Print the outcome in one line; return the exit status."""
    written = f"{rows} rows in {out}" if rows >= FEWEST_ROWS else "nothing written"
    torque = "torque off"
    if unreleased:
        where = "any servo" if len(unreleased) == len(mountings) else ", ".join(unreleased)
        torque = f"the torque of {where} may still be on: switch off the supply"
    if outcome.stopped:
        print(f"sim2real record: {outcome.stopped}; {written}; {torque}", file=sys.stderr)
        return 1
    missing = ", ".join(f"{name} {count}" for name, count in outcome.missing.items())
    late = 1e3 * float(np.quantile(outcome.late_s, 0.999))
    print(
        f"{written}; missing positions: {missing}; {outcome.skipped} set-points skipped; "
        f"99.9 % of cycles within {late:.1f} ms; {torque}"
    )
    return 1 if unreleased else 0


def _summary(outcome: Outcome, rows: int) -> dict[str, Any]:
    late = float(np.quantile(outcome.late_s, 0.999)) if outcome.late_s else 0.0
    return {
        "rows": rows,
        "missing_positions": outcome.missing,
        "skipped_set_points": outcome.skipped,
        "late_999_s": round(late, 6),
        "stopped": outcome.stopped,
    }


def _signal(options: argparse.Namespace, joints: Sequence[Joint]) -> Excitation:
    if options.signal not in UNIT:
        path = Path(options.signal)
        if path.suffix != ".csv":
            raise InputError("SIGNAL", "", repr(options.signal), f"{', '.join(UNIT)} or a .csv")
        return played(path, joints, rate_hz=RATE_HZ)
    if options.amplitude is not None and not options.amplitude > 0:
        raise InputError("--amplitude", "", f"{options.amplitude:g} rad", "more than 0 rad")
    return excitation(
        options.signal,
        joints,
        seconds=options.seconds,
        rate_hz=RATE_HZ,
        rng=np.random.default_rng(options.seed),
        amplitude_rad=options.amplitude,
        shape=Shape(options.frequency, tuple(options.band)),
    )


def _joints(robot: Robot, names: Sequence[str] | None) -> list[Joint]:
    for name in names or ():
        if robot.joint(name) is None:
            known = ", ".join(joint.name for joint in robot.joints)
            raise InputError("--joints", "", f"no joint {name!r}", f"some of {known}")
    return [joint for joint in robot.joints if names is None or joint.name in names]


def _mountings(options: argparse.Namespace, robot: Robot) -> tuple[Mounting, ...]:
    for option, value in (("--port", options.port), ("--ids", options.ids)):
        if value is None:
            raise InputError(option, "", "nothing", "it, unless with --dry-run")
    if not 0 < options.max_temperature <= HOTTEST_POSSIBLE_C:
        found = f"{options.max_temperature:g} C"
        expected = f"at most {HOTTEST_POSSIBLE_C:g} C"
        raise InputError("--max-temperature", "", found, expected)
    names = [joint.name for joint in _joints(robot, options.joints)]
    return mount(
        robot,
        _integers("--ids", options.ids),
        joints=names,
        trim_ticks=_integers("--trim", options.trim) if options.trim else None,
        reverse=options.reverse,
    )


def _loads(text: str, joints: Sequence[str]) -> dict[str, dict[str, float]]:
    try:
        inertias = [float(number) for number in text.split(",")]
    except ValueError:
        inertias = []
    if len(inertias) != len(joints) or not all(0 < x < np.inf for x in inertias):
        expected = f"{len(joints)} numbers above 0 in kg m2, for {', '.join(joints)}"
        raise InputError("--inertia", "", repr(text), expected)
    return {
        joint: {"inertia_kgm2": inertia} for joint, inertia in zip(joints, inertias, strict=True)
    }


def _planned(signal: str) -> dict[str, Any]:
    """What the JSON beside commands says of the loads, the context and rivals of a design."""
    sidecar = Path(signal).with_suffix(".json")
    if signal in UNIT or not sidecar.exists():
        return {"loads": {}}
    content = read_json(sidecar, SCHEMA)
    return {"loads": {}} | {name: content[name] for name in _PLANNED if name in content}


def _integers(option: str, text: str) -> list[int]:
    try:
        return [int(number) for number in text.split(",")]
    except ValueError:
        raise InputError(option, "", repr(text), "whole numbers, as 1,2,3") from None


def _check_out(options: argparse.Namespace) -> None:
    if options.out is None or options.out.suffix != ".csv":
        raise InputError("--out", "", str(options.out or "nothing"), "a file name ending in .csv")
    check_writable(options.out)
    if not options.overwrite:
        for path in (options.out, options.out.with_suffix(".json")):
            if path.exists():
                raise InputError(path, "", "a file already", "another name, or --overwrite")


def _described(signal: Excitation, joints: Sequence[Joint]) -> str:
    lines = [f"{signal.t.size} set-points in {signal.t[-1]:.2f} s, {RATE_HZ:g} a second"]
    for j, joint in enumerate(joints):
        sent, (low, high) = signal.command[:, j], joint.limits_rad
        lines.append(
            f"{joint.name}: from {sent[0]:+.3f}, {sent.min():+.3f} to {sent.max():+.3f} rad "
            f"(limits {low:+.3f} to {high:+.3f}), fastest {signal.largest_rate[j]:.2f} rad/s "
            f"(limit {joint.servo.no_load_speed_rad_s:.2f})"
        )
    return "\n".join([*lines, *signal.notes])


def _plot(path: Path | None, signal: Excitation, joints: Sequence[Joint]) -> None:
    if path is None:
        return
    from sim2real.hardware.plots import signal_figure
    from sim2real.report import save_png

    save_png(signal_figure(signal, joints), path)
