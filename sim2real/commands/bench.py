"""``sim2real bench``: from servos on a port to identified gains and a page."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from sim2real import verbs
from sim2real.check import check
from sim2real.commands.command import numbers
from sim2real.commands.record import check_temperature, sidecar
from sim2real.errors import InputError, if_installed
from sim2real.hardware.bench import Weight, loads, robot_text, scan, table
from sim2real.hardware.buses import Connection, bus_class, connection
from sim2real.hardware.mounting import Wiring, check_ids
from sim2real.hardware.servo_bus import PATIENCE_S, Found, Stopped
from sim2real.hardware.session import RATE_HZ, bus_settings, drive, mounted, priority
from sim2real.model import Model, write_model
from sim2real.output import check_writable, provenance, write_whole
from sim2real.recording import Recording, read_recording
from sim2real.robot import Robot, read_robot
from sim2real.servo.prediction import replay
from sim2real.signals import excitation

FILES = ("robot.toml", "steps.csv", "steps.json", "model.json", "index.html")


def run(options: argparse.Namespace) -> int:
    """Scan, record steps, identify, and write a page; 1 if the recording stopped early, else 0."""
    ids = numbers("--ids", options.ids, int, "numbers, as 1,2,3")
    check_ids(ids, bus_class(options.bus).protocol.largest_id)
    _check(options)
    folder = options.out
    given = _given_loads(options, ids)
    with priority(), connection(options.bus, options.port, options.baud) as link:
        try:
            servos = _found(link, ids)
            print(table(servos))
            text = None if options.robot else robot_text(options.bus, servos, options.reach)
            if given is None:
                given = [_asked(servo_id) for servo_id in ids]
            if text is not None:
                write_whole(folder / "robot.toml", text)
            robot = read_robot(options.robot or folder / "robot.toml")
            status = _record(options, link, robot, ids, given)
        except (Stopped, OSError) as error:
            print(f"sim2real bench: {error}", file=sys.stderr)
            return 1
        finally:
            if options.robot is None and not (folder / "steps.csv").exists():
                (folder / "robot.toml").unlink(missing_ok=True)
    if status:
        return status
    recording = read_recording(folder / "steps.csv")
    model = verbs.identify([recording], robot, seed=options.seed)
    write_model(model, folder / "model.json")
    print(model)
    _write_page(options, recording, robot, model)
    return 0


def _record(
    options: argparse.Namespace,
    link: Connection,
    robot: Robot,
    ids: Sequence[int],
    given: Sequence[Weight | float | None],
) -> int:
    """Record steps of all joints."""
    wiring = Wiring(ids)
    wiring.check(robot, link.bus.protocol.largest_id)
    rng = np.random.default_rng(options.seed)
    signal = excitation("steps", robot.joints, seconds=options.seconds, rate_hz=RATE_HZ, rng=rng)
    mountings = mounted(link, robot, wiring)
    sent = sidecar(
        signal,
        {"loads": loads(signal.joints, given, hangs=options.shaft == "horizontal")},
        name="steps",
        medium="air",
        source="Recorded by 'sim2real bench'.",
        bus=bus_settings(link, options.port, mountings),
        provenance=provenance([robot], options.seed),
    )
    out = options.out / "steps.csv"
    result = drive(link, mountings, signal, out, sent, hottest_C=options.max_temperature)
    problem = f"{result.stopped}; " if result.stopped else ""
    line = f"{problem}{result.written(out)}; {result.torque}"
    if problem or result.unreleased:
        print(f"sim2real bench: {line}", file=sys.stderr)
        return 1
    print(line)
    return 0


def _write_page(
    options: argparse.Namespace, recording: Recording, robot: Robot, model: Model
) -> None:
    """The page, if the extra for reports is installed."""
    with if_installed("page"):
        from sim2real.report.identification import identification_section
        from sim2real.report.page import write_page
        from sim2real.report.recordings import recordings_section

        shown = replay(model, [recording])
        fits = [(one.recording, one.joint, one.predicted, one.held_out) for one in shown]
        checked = check(recording, robot, seed=options.seed)
        sections = [identification_section(model, fits), recordings_section([recording], [checked])]
        page = options.out / "index.html"
        write_page(page, robot.name, f"{options.bus} servos", sections, model.provenance)
        print(f"\npage: {page}")


def _found(link: Connection, ids: Sequence[int]) -> list[Found]:
    servos, _ = scan(link.bus, ids, PATIENCE_S)
    missing = sorted(set(ids) - {servo.servo_id for servo in servos})
    if missing:
        asked = f"servo {', '.join(map(str, missing))} ({link.bus.name}, {link.bus.baud} baud)"
        raise Stopped(f"no reply from {asked}: check supply, --ids, --bus and --baud")
    return servos


def _check(options: argparse.Namespace) -> None:
    check_temperature(options.max_temperature)
    for name in FILES[options.robot is not None :]:
        path = check_writable(options.out / name)
        if path.exists() and not options.overwrite:
            raise InputError(path, "", "a file already", "another --out, or --overwrite")


def _given_loads(
    options: argparse.Namespace, ids: Sequence[int]
) -> list[Weight | float | None] | None:
    """Loads from the options; None if they have to be asked for."""
    if options.unknown_load:
        return [None] * len(ids)
    if options.inertia is not None:
        return list(_positive("--inertia", options.inertia, len(ids)))
    if options.mass is not None or options.arm is not None:
        masses = _positive("--mass", options.mass, len(ids))
        arms = _positive("--arm", options.arm, len(ids))
        return [Weight(mass, arm) for mass, arm in zip(masses, arms, strict=True)]
    if not sys.stdin.isatty():
        expected = "--mass and --arm, --inertia or --unknown-load"
        raise InputError("--mass", "", "no load, and no terminal to ask", expected)
    return None


def _asked(servo_id: int) -> Weight | None:
    """The load, asked for on the terminal; None if it is unknown."""
    mass = _answer(f"mass of the load on servo {servo_id}, kg (empty: unknown): ")
    while mass is not None:
        if arm := _answer("distance of its centre from the shaft, m: "):
            return Weight(mass, arm)
    return None


def _answer(question: str) -> float | None:
    """A number above 0, or None for an empty line."""
    while True:
        text = input(question).strip()
        if not text:
            return None
        try:
            number = float(text)
        except ValueError:
            number = 0.0
        if 0 < number < np.inf:
            return number
        print(f"found {text!r}, expected a number above 0")


def _positive(option: str, text: str | None, count: int) -> list[float]:
    expected = f"{count} numbers above 0, one for each servo"
    if text is None:
        raise InputError(option, "", "nothing", expected)
    return numbers(option, text, float, expected, count=count, positive=True)
