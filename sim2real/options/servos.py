"""Commands about servos: recordings, their fit, what it leaves out, ranges."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.options.command import Command, add_recordings


def _check(command: argparse.ArgumentParser) -> None:
    add_recordings(command)
    command.add_argument("--robot", type=Path, help="robot.toml, to check limits and names too")


def _identify(command: argparse.ArgumentParser) -> None:
    add_recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--out", type=Path, required=True, metavar="MODEL", help="MODEL.json")
    command.add_argument(
        "--held-out",
        metavar="NAME",
        help="recording to score on, not fit (default: the last; of a lone one its last quarter)",
    )
    command.add_argument(
        "--effects",
        nargs="+",
        default=(),
        metavar="EFFECT",
        help="effects to fit with the gains, as load_friction or unmodelled_inertia",
    )
    command.add_argument(
        "--law",
        choices=("pd", "motor"),
        help="the linear servo, or a motor on its data sheet's line (default: motor; pd with "
        "--effects)",
    )
    command.add_argument("--no-plots", action="store_true", help="write no MODEL.JOINT.png")


def _density(command: argparse.ArgumentParser) -> None:
    command.add_argument("robot", type=Path, metavar="ROBOT", help="robot.toml")
    command.add_argument("--model", type=Path, help="MODEL.json to put the densities into")
    command.add_argument("--out", type=Path, metavar="MODEL", help="the model with them")
    command.add_argument("--png", type=Path, metavar="PNG", help="how the mass is spread")


def _ranges(command: argparse.ArgumentParser) -> None:
    add_recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, required=True, help="MODEL.json")
    command.add_argument("--out", type=Path, required=True, metavar="RANGES", help="ranges.json")
    command.add_argument("--steps", type=int, default=2000, help="of each chain (default 2000)")
    command.add_argument("--walkers", type=int, default=32, help="of each chain (default 32)")
    command.add_argument(
        "--held-out", metavar="NAME", help="recording to check on, not sample (default: the last)"
    )
    command.add_argument("--no-page", action="store_true", help="write no RANGES.html")


def _predict(command: argparse.ArgumentParser) -> None:
    command.add_argument("model", type=Path, metavar="MODEL", help="MODEL.json")
    command.add_argument("commands", type=Path, metavar="COMMANDS", help="CSV: t_s, J.command_rad")
    command.add_argument("--out", type=Path, required=True, metavar="CSV", help="predicted.csv")


def _diagnose(command: argparse.ArgumentParser) -> None:
    add_recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, help="MODEL.json to start from")
    command.add_argument(
        "--references",
        type=Path,
        nargs="+",
        metavar="RECORDING",
        help="recordings from before: name only what has changed since",
    )
    command.add_argument(
        "--out", type=Path, required=True, metavar="DIAGNOSIS", help="diagnosis.json"
    )
    command.add_argument(
        "--water",
        type=Path,
        metavar="MODEL",
        help="swims: go on in the fluid, with the water of MODEL.json by calibrate --fluid",
    )
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0, for the fluid")
    command.add_argument("--cell-m", type=float, default=0.02, metavar="M", help="side of a cell")
    command.add_argument(
        "--rollouts", type=int, default=48, metavar="N", help="of a batch in the fluid (default 48)"
    )
    command.add_argument(
        "--negligible",
        type=float,
        default=0.05,
        metavar="SHARE",
        help="what changes the held-out error by less is listed, no verdict (default 0.05)",
    )
    command.add_argument("--no-page", action="store_true", help="write no DIAGNOSIS.html")


def _import(command: argparse.ArgumentParser) -> None:
    command.add_argument("source", type=Path, help="a log (.json), or a ROS 1 or 2 bag")
    command.add_argument(
        "--out", type=Path, required=True, metavar="CSV", help="recording to write"
    )
    command.add_argument("--state-topic", metavar="TOPIC", help="bag: measured joint states")
    command.add_argument(
        "--command-topic",
        metavar="TOPIC",
        action="append",
        help="bag: set-points; once, or once for each joint",
    )
    command.add_argument("--joints", nargs="+", metavar="JOINT", help="bag: joints, in order")


def _demo(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--data", type=Path, default=Path("datasets/servo_steps"), metavar="FOLDER"
    )
    command.add_argument("--pool", type=Path, default=Path("datasets/pool"), metavar="FOLDER")
    command.add_argument("--out", type=Path, default=Path("reports/demo"), metavar="FOLDER")


COMMANDS = (
    Command(
        "check",
        "sim2real.commands.check",
        _check,
        "say what recordings are like, and what they can identify, before anyone fits",
        "sim2real check steps.csv sine.csv --robot robot.toml",
    ),
    Command(
        "identify",
        "sim2real.commands.identify",
        _identify,
        "identify the gains and latency of each servo from recorded steps",
        "sim2real identify steps.csv sine.csv square.csv --robot robot.toml --out model.json",
    ),
    Command(
        "density",
        "sim2real.commands.density",
        _density,
        "say how a robot's mass is spread along it, link by link",
        "sim2real density robot.toml --model model.json --out weighed.json",
    ),
    Command(
        "ranges",
        "sim2real.commands.ranges",
        _ranges,
        "make randomization ranges, each from data, and a posterior sample",
        "sim2real ranges steps.csv square.csv --robot robot.toml --model model.json "
        "--out ranges.json",
        resumes=True,
    ),
    Command(
        "predict",
        "sim2real.commands.predict",
        _predict,
        "simulate a model from rest on the commands of a CSV",
        "sim2real predict model.json chirp.csv --out predicted.csv",
    ),
    Command(
        "diagnose",
        "sim.commands.diagnose",
        _diagnose,
        "say which physics the fitted servos leave out, model it and show the fit improve",
        "sim2real diagnose steps.csv chirp.csv --robot robot.toml --out diagnosis.json",
    ),
    Command(
        "import",
        "sim2real.commands.import_logs",
        _import,
        "turn logs of other projects into recordings",
        "sim2real import run.bag --state-topic /joint_states --command-topic /goal --out run.csv",
    ),
    Command(
        "demo",
        "rl.commands.demo",
        _demo,
        "run the whole chain on the shipped data and write an HTML report",
        "sim2real demo --out reports/demo",
    ),
)
"""In the order in which help lists them."""
