"""Command-line options for recordings, identification and ranges of servos."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real import verbs
from sim2real.commands.command import (
    Command,
    add_file,
    add_flag,
    add_former,
    add_recordings,
    add_views,
)
from sim2real.commands.verb import add_verb


def _example(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--out",
        type=Path,
        default=Path("example"),
        metavar="FOLDER",
        help="folder to write (default example)",
    )


def _check(command: argparse.ArgumentParser) -> None:
    add_recordings(command)
    add_file(
        command, "--robot", "ROBOT", "the robot, to check limits and names as well (robot.toml)"
    )


def _identify(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.identify)
    add_file(command, "--out", "MODEL", "model to write (MODEL.json)", required=True)
    add_flag(command, "--no-plots", "do not plot the fits (MODEL.JOINT.png)")
    add_views(command)


def _density(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.density, positional=("robot",))
    add_file(command, "--model", "MODEL", "model to add the densities to (MODEL.json)")
    add_file(command, "--out", "MODEL", "model to write (MODEL.json)")
    add_file(command, "--plot", "PNG", "plot of the mass distribution to write")
    add_former(command, "--png", "plot")


def _ranges(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.ranges, leave_out=("chains",))
    add_file(command, "--out", "RANGES", "ranges to write (ranges.json)", required=True)
    add_flag(command, "--no-page", "do not write the HTML report")


def _predict(command: argparse.ArgumentParser) -> None:
    add_file(command, "model", "MODEL", "model (MODEL.json)")
    add_file(command, "commands", "COMMANDS", "commands: a CSV with t_s and J.command_rad")
    add_file(command, "--out", "CSV", "prediction to write (predicted.csv)", required=True)
    add_views(command)


def _import(command: argparse.ArgumentParser) -> None:
    add_file(
        command,
        "source",
        "source",
        "a BAM log (.json), a ROS 1 or 2 bag, a LeRobot dataset (its folder), a table "
        "(.csv, .tsv; .npz of MuJoCo's time, qpos, ctrl), or BAM's parameters of a servo (.json)",
    )
    add_file(command, "--out", "CSV", "recording to write (of parameters: model)", required=True)
    command.add_argument("--state-topic", metavar="TOPIC", help="bag: measured joint states")
    command.add_argument(
        "--command-topic",
        metavar="TOPIC",
        action="append",
        help="bag: commanded positions; once, or once for each joint",
    )
    command.add_argument(
        "--joints", nargs="+", metavar="JOINT", help="bag, dataset: joints, in order"
    )
    command.add_argument(
        "--units",
        nargs="+",
        metavar="UNIT",
        help="dataset, table: unit of the angles: rad, deg, turns, counts, range_m100_100 or"
        " range_0_100; JOINT=UNIT for one joint, JOINT.command=UNIT or JOINT.position=UNIT for one"
        " of its columns",
    )
    add_file(command, "--calibration", "JSON", "calibration file of LeRobot")
    command.add_argument("--counts-per-turn", type=int, metavar="N", help="encoder counts per turn")
    command.add_argument("--zero-count", type=float, metavar="N", help="encoder count at angle 0")
    command.add_argument(
        "--episode", type=int, metavar="K", help="dataset: number of the episode, from 0"
    )
    command.add_argument(
        "--columns",
        nargs="+",
        metavar="OURS=THEIRS",
        help="table: names of the columns, t=COLUMN J.command=COLUMN J.position=COLUMN ...; "
        "of arrays 'qpos[0]'",
    )
    command.add_argument("--time-unit", choices=("s", "ms", "us", "ns"), help="table: unit of t")
    command.add_argument(
        "--inertia",
        nargs="+",
        metavar="J=KGM2",
        help="load of a joint: its inertia without the servo's rotor, kg m2",
    )
    command.add_argument(
        "--pendulum",
        nargs="+",
        metavar="J=KG,M",
        help="load of a joint: mass that hangs straight down at angle 0, and its distance from "
        "the shaft",
    )


def _completion(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "shell", choices=("bash", "zsh", "tcsh"), help="shell to write the script for"
    )


COMMANDS = (
    Command("example", "sim2real.commands.example", _example, "sim2real example --out example"),
    Command(
        "check",
        "sim2real.commands.check",
        _check,
        "sim2real check steps.csv sine.csv --robot robot.toml",
    ),
    Command(
        "identify",
        "sim2real.commands.identify",
        _identify,
        "sim2real identify steps.csv sine.csv square.csv --robot robot.toml --out model.json",
    ),
    Command(
        "density",
        "sim2real.commands.density",
        _density,
        "sim2real density robot.toml --model model.json --out weighed.json",
    ),
    Command(
        "ranges",
        "sim2real.commands.ranges",
        _ranges,
        "sim2real ranges steps.csv square.csv --robot robot.toml --model model.json "
        "--out ranges.json",
        resumes=True,
    ),
    Command(
        "predict",
        "sim2real.commands.predict",
        _predict,
        "sim2real predict model.json chirp.csv --out predicted.csv",
    ),
    Command(
        "import",
        "sim2real.commands.import_logs",
        _import,
        "sim2real import run.bag --state-topic /joint_states --command-topic /goal --out run.csv",
    ),
    Command(
        "completion",
        "sim2real.commands.completion",
        _completion,
        "sim2real completion bash > ~/.local/share/bash-completion/completions/sim2real",
    ),
)
