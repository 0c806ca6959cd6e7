"""``sim2real bench``, from servos on a port to identified gains and a page."""

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np

from sim2real import verbs
from sim2real.check import check
from sim2real.commands.buses import scanned, table
from sim2real.commands.command import numbers
from sim2real.commands.record import check_new, check_temperature, report, sidecar
from sim2real.errors import InputError, if_installed
from sim2real.hardware.buses import Connection, bus_class, connection, ids_of
from sim2real.hardware.mounting import places
from sim2real.hardware.recorder import RATE_HZ, Run, drive, priority
from sim2real.hardware.registers import model_named
from sim2real.hardware.servo_bus import PATIENCE_S, Found, Stopped
from sim2real.model import write_model
from sim2real.output import provenance, write_whole
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot
from sim2real.servo.prediction import replay
from sim2real.signals import excitation

Load = dict[str, float]
"""A load as in a recording's JSON; empty if it is unknown."""
FILES = ("robot.toml", "steps.csv", "steps.json", "model.json", "index.html")


def bench(options: argparse.Namespace) -> int:
    """Scan, record steps, identify, and write a page; 1 if the recording stopped early, else 0."""
    ids = ids_of(options.ids, bus_class(options.bus))
    check_temperature(options.max_temperature)
    for name in FILES[options.robot is not None :]:
        check_new(options.out / name, options)
    loads, steps = _given_loads(options, len(ids)), options.out / "steps.csv"
    with priority(), connection(options.bus, options.port, options.baud) as link:
        try:
            robot, result = _recorded(options, link, ids, loads)
        except (Stopped, OSError) as error:
            print(f"sim2real bench: {error}", file=sys.stderr)
            return 1
        finally:
            if options.robot is None and not steps.exists():
                (options.out / "robot.toml").unlink(missing_ok=True)
    if status := report("bench", steps, result):
        return status
    recording = read_recording(steps)
    model = verbs.identify([recording], robot, seed=options.seed)
    write_model(model, options.out / "model.json")
    print(model)
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
    return 0


def _recorded(
    options: argparse.Namespace, link: Connection, ids: Sequence[int], loads: list[Load] | None
) -> tuple[Robot, Run]:
    """Find the servos, ask for their loads unless they are given, and record steps of all."""
    servos, _ = scanned(link.bus, ids, PATIENCE_S)
    if missing := sorted(set(ids) - {servo.servo_id for servo in servos}):
        asked = f"servo {', '.join(map(str, missing))} ({link.bus.name}, {link.bus.baud} baud)"
        raise Stopped(f"no reply from {asked}: check supply, --ids, --bus and --baud")
    print(table(servos))
    text = None if options.robot else robot_text(options.bus, servos, options.reach)
    if loads is None:
        loads = [_asked(servo_id, _hangs(options)) for servo_id in ids]
    if text is not None:
        write_whole(options.out / "robot.toml", text)
    robot = read_robot(options.robot or options.out / "robot.toml")
    wired = places(robot, ids)
    rng = np.random.default_rng(options.seed)
    signal = excitation("steps", robot.joints, seconds=options.seconds, rate_hz=RATE_HZ, rng=rng)
    sent = sidecar(
        signal,
        {"loads": {one.joint.name: load for one, load in zip(wired, loads, strict=True) if load}},
        name="steps",
        medium="air",
        source="Recorded by 'sim2real bench'.",
        provenance=provenance([robot], options.seed),
    )
    steps, limit = options.out / "steps.csv", options.max_temperature
    return robot, drive(link, robot, wired, signal, steps, sent, hottest_C=limit)


def robot_text(
    bus: str, servos: Sequence[Found], reach_rad: float, *, longest_rad: float = 2.5
) -> str:
    """A ``robot.toml`` with a joint of +-``reach_rad`` a servo; ``InputError`` without ratings."""
    if not 0 < reach_rad <= longest_rad:
        expected = f"more than 0 and at most {longest_rad:g} rad"
        raise InputError("--reach", "", f"{reach_rad:g} rad", expected)
    parts, joints = ['name = "bench"'], []
    for k, servo in enumerate(servos, start=1):
        model, supply = model_named(bus, servo.model), servo.supply_V
        rating = None if model is None or supply is None else model.rating(supply)
        if model is None or rating is None:
            found = f"no ratings of servo {servo.servo_id} ({servo.model or bus})"
            raise InputError("--robot", "", found, "a robot.toml with its torque and speed")
        parts.append(f"""
# {model.name} at {rating.supply_V:g} V: {model.source}
[servos.j{k}]
max_torque_Nm = {rating.stall_torque_Nm:g}
no_load_speed_rad_s = {rating.no_load_speed_rad_s:.3f}
position_step_rad = {2 * math.pi / model.ticks_per_turn:.6f}
""")
        limits = f"limits_rad = [{-reach_rad:g}, {reach_rad:g}]"
        joints.append(f'[[joints]]\nname = "j{k}"\nservo = "j{k}"\n{limits}\n')
    links = [f'[[links]]\nname = "link{k + 1}"\n' for k in range(len(servos) + 1)]
    return "\n".join([*parts, *links, *joints])


def load_of(mass_kg: float, arm_m: float, *, hangs: bool) -> Load:
    """Load of a mass at the end of an arm, as in a recording's JSON.

    With gravity if it hangs straight down at 0; otherwise the shaft is vertical.
    """
    load = {"inertia_kgm2": mass_kg * arm_m**2}
    return load | ({"pendulum_mass_kg": mass_kg, "pendulum_length_m": arm_m} if hangs else {})


def _given_loads(options: argparse.Namespace, count: int) -> list[Load] | None:
    """Loads from the options; None if they have to be asked for."""
    if options.unknown_load:
        return [{}] * count
    if options.inertia is not None:
        return [{"inertia_kgm2": x} for x in _positive("--inertia", options.inertia, count)]
    if options.mass is not None or options.arm is not None:
        masses = _positive("--mass", options.mass, count)
        arms, hangs = _positive("--arm", options.arm, count), _hangs(options)
        return [load_of(*pair, hangs=hangs) for pair in zip(masses, arms, strict=True)]
    if not sys.stdin.isatty():
        expected = "--mass and --arm, --inertia or --unknown-load"
        raise InputError("--mass", "", "no load, and no terminal to ask", expected)
    return None


def _hangs(options: argparse.Namespace) -> bool:
    return bool(options.shaft == "horizontal")


def _asked(servo_id: int, hangs: bool) -> Load:
    """The load, asked for on the terminal; empty if it is unknown."""
    mass = _answer(f"mass of the load on servo {servo_id}, kg (empty: unknown): ")
    while mass is not None:
        if arm := _answer("distance of its centre from the shaft, m: "):
            return load_of(mass, arm, hangs=hangs)
    return {}


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
