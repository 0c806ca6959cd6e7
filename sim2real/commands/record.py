"""``sim2real record``, of a signal on the servos of a bus."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.commands.command import numbers
from sim2real.errors import InputError
from sim2real.hardware.buses import bus_class, connection, ids_of
from sim2real.hardware.mounting import Place, places
from sim2real.hardware.recorder import RATE_HZ, Run, drive, priority
from sim2real.hardware.servo_bus import Stopped
from sim2real.output import check_writable, provenance
from sim2real.recording import SCHEMA
from sim2real.robot import Joint, Robot, read_robot
from sim2real.signals import UNIT, Excitation, Shape, excitation, played
from sim2real.structured import read_json

_PLANNED = ("loads", "context", "rivals")
HOTTEST_POSSIBLE_C = 85.0  # where the servos switch off by themselves


def record(options: argparse.Namespace) -> int:
    """Play a signal on the servos of a bus and write rows; 1 if it was stopped early, else 0."""
    robot = read_robot(options.robot)
    joints = _joints(robot, options.joints)
    signal = _signal(options, joints)
    if options.dry_run:
        print(_described(signal, joints))
        _plot(options.plot, signal, joints)
        return 0
    wired = _places(options, robot)
    sent = sidecar(
        signal,
        _planned(options.signal),
        medium=options.medium,
        source=options.source or f"Recorded by 'sim2real record' on {robot.name}.",
        name=str(options.signal),
        provenance=provenance([options.robot], options.seed),
    )
    if options.inertia:
        text, count = options.inertia, len(joints)
        expected = f"{count} numbers above 0 in kg m2, for {', '.join(signal.joints)}"
        inertias = numbers("--inertia", text, float, expected, count=count, positive=True)
        loads = zip(signal.joints, inertias, strict=True)
        sent["loads"] = {joint: {"inertia_kgm2": inertia} for joint, inertia in loads}
    out = options.out
    if out is None or out.suffix != ".csv":
        raise InputError("--out", "", str(out or "nothing"), "a file name ending in .csv")
    for path in (out, out.with_suffix(".json")):
        check_new(path, options)
    _plot(options.plot, signal, joints)
    for note in signal.notes:
        print(note)
    with priority(), connection(options.bus, options.port, options.baud) as link:
        try:
            run = drive(link, robot, wired, signal, out, sent, hottest_C=options.max_temperature)
        except (Stopped, OSError) as error:
            print(f"sim2real record: {error}; nothing written", file=sys.stderr)
            return 1
    return report("record", out, run)


def sidecar(
    signal: Excitation, planned: dict[str, Any], *, name: str, **more: object
) -> dict[str, object]:
    """The JSON of a recording of a signal; ``planned`` has the loads, ``more`` the medium."""
    played = {"name": name, "notes": list(signal.notes)}
    head = {"schema": SCHEMA, "kind": "servo", "joints": list(signal.joints), "signal": played}
    return head | planned | more


def check_temperature(limit_C: float) -> None:
    """Raise InputError if servos would switch themselves off below this limit."""
    if not 0 < limit_C <= HOTTEST_POSSIBLE_C:
        expected = f"at most {HOTTEST_POSSIBLE_C:g} C"
        raise InputError("--max-temperature", "", f"{limit_C:g} C", expected)


def check_new(path: Path, options: argparse.Namespace) -> None:
    """Raise InputError if a file can't be written, or exists and is not to be replaced."""
    check_writable(path)
    if path.exists() and not options.overwrite:
        raise InputError(path, "", "a file already", "another name, or --overwrite")


def report(command: str, out: Path, run: Run) -> int:
    """Print the outcome in one line; return the exit status."""
    if run.stopped:
        line = f"sim2real {command}: {run.stopped}; {run.written(out)}; {run.torque}"
        print(line, file=sys.stderr)
        return 1
    missing = ", ".join(f"{name} {count}" for name, count in run.missing.items())
    print(
        f"{run.written(out)}; missing positions: {missing}; {run.skipped} set-points skipped; "
        f"99.9 % of cycles within {1e3 * run.late_999_s:.1f} ms; {run.torque}"
    )
    return 1 if run.unreleased else 0


def _signal(options: argparse.Namespace, joints: Sequence[Joint]) -> Excitation:
    if options.signal not in UNIT:
        path = Path(options.signal)
        if path.suffix != ".csv":
            raise InputError("SIGNAL", "", repr(options.signal), f"{', '.join(UNIT)} or a .csv")
        return played(path, joints, rate_hz=RATE_HZ)
    if options.amplitude is not None and not options.amplitude > 0:
        raise InputError("--amplitude", "", f"{options.amplitude:g} rad", "more than 0 rad")
    # the defaults of sine and square are those of the paper's calibration, Fig. 3
    amplitude, frequency = {"sine": (0.52, 1.0), "square": (0.52, 0.5)}.get(
        options.signal, (None, 1.0)
    )
    return excitation(
        options.signal,
        joints,
        seconds=options.seconds,
        rate_hz=RATE_HZ,
        rng=np.random.default_rng(options.seed),
        amplitude_rad=amplitude if options.amplitude is None else options.amplitude,
        shape=Shape(
            frequency if options.frequency is None else options.frequency, tuple(options.band)
        ),
    )


def _joints(robot: Robot, names: Sequence[str] | None) -> list[Joint]:
    for name in names or ():
        if robot.joint(name) is None:
            known = ", ".join(joint.name for joint in robot.joints)
            raise InputError("--joints", "", f"no joint {name!r}", f"some of {known}")
    return [joint for joint in robot.joints if names is None or joint.name in names]


def _places(options: argparse.Namespace, robot: Robot) -> list[Place]:
    for name in ("port", "ids"):
        if getattr(options, name) is None:
            raise InputError(f"--{name}", "", "nothing", "it, unless with --dry-run")
    check_temperature(options.max_temperature)
    trim = options.trim and numbers("--trim", options.trim, int, "whole numbers, as 4,0,-2")
    ids, joints = ids_of(options.ids, bus_class(options.bus)), _joints(robot, options.joints)
    return places(robot, ids, [joint.name for joint in joints], trim, options.reverse)


def _planned(signal: str) -> dict[str, Any]:
    """Loads, context and rivals of a design, from the JSON in the folder of its commands."""
    path = Path(signal).with_suffix(".json")
    if signal in UNIT or not path.exists():
        return {"loads": {}}
    content = read_json(path, SCHEMA)
    return {"loads": {}} | {name: content[name] for name in _PLANNED if name in content}


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
    from sim2real.report.drawing import save_png

    save_png(signal_figure(signal, joints), path)
