"""Command-line options of exports to other tools and of imports of robots."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.commands.command import Command, add_file


def _export_servo(command: argparse.ArgumentParser) -> None:
    add_file(command, "model", "MODEL", "identified servos (MODEL.json)")
    command.add_argument(
        "--to",
        required=True,
        choices=("mujoco", "mjlab", "isaaclab", "newton", "genesis", "urdf", "json"),
        help="simulator or format to write for",
    )
    add_file(command, "--out", "FILE", "file to write", required=True)
    add_file(
        command, "--robot", "ROBOT", "the robot, for joint limits and data sheets (robot.toml)"
    )
    command.add_argument(
        "--recordings",
        nargs="+",
        type=Path,
        default=(),
        metavar="CSV",
        help="recordings to refit to if the simulator lacks an effect of the model, and to compare "
        "with; the last is held out (default: the model's own predictions)",
    )
    command.add_argument(
        "--which",
        choices=("nearest", "effects", "plain"),
        default="nearest",
        help="export the effects of the model, a plain servo without them, or whichever of both is "
        "nearer to the recordings (default)",
    )


def _export_ranges(command: argparse.ArgumentParser) -> None:
    add_file(command, "ranges", "RANGES", "randomization ranges (ranges.json)")
    command.add_argument(
        "--to",
        required=True,
        choices=("isaaclab", "mjlab", "newton", "mujoco-playground"),
        help="simulator to write for",
    )
    add_file(command, "--out", "FILE", "Python file to write", required=True)


def _robot(command: argparse.ArgumentParser) -> None:
    command.add_argument("action", choices=("from-urdf",), help="format to read")
    add_file(command, "source", "FILE", "description of the robot (URDF)")
    add_file(command, "--out", "TOML", "robot to write (robot.toml)", required=True)
    command.add_argument(
        "--joints", nargs="+", metavar="JOINT", help="joints to take, in order (default: all)"
    )


def _servos(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "name", nargs="?", metavar="NAME", help="servo to show or to write; 'add' to prepare one"
    )
    command.add_argument(
        "model", nargs="?", type=Path, metavar="MODEL", help="add: identified servo (MODEL.json)"
    )
    add_file(command, "--out", "MODEL", "model to write (add: entry, NAME.json)")
    command.add_argument(
        "--joints", nargs="+", metavar="JOINT", help="joints that have this servo (default j1)"
    )
    command.add_argument(
        "--firmware-gain",
        type=float,
        metavar="X",
        help="write the model for this gain of the firmware; add: the gain of the recordings",
    )
    command.add_argument(
        "--supply",
        type=float,
        metavar="V",
        help="write the model for this supply voltage; add: that of the recordings",
    )
    add_file(command, "--plot", "PNG", "plot of stall torque and no-load speed")
    add = command.add_argument_group("add", "what the entry states, unless the model does")
    add.add_argument("--joint", metavar="JOINT", help="joint of a model that has several")
    add.add_argument("--as", dest="entry", metavar="NAME", help="name of the entry")
    add.add_argument("--type", metavar="TEXT", help="make and type of the servo")
    add.add_argument("--source", metavar="TEXT", help="where the recordings come from")
    add.add_argument("--licence", metavar="TEXT", help="licence of the recordings")
    add.add_argument("--date", metavar="DAY", help="day of the recordings (2026-01-31)")


COMMANDS = (
    Command(
        "robot",
        "sim2real.commands.robot",
        _robot,
        "sim2real robot from-urdf arm.urdf --out robot.toml",
    ),
    Command(
        "export-servo",
        "sim2real.commands.export_servo",
        _export_servo,
        "sim2real export-servo diagnosis.enriched.json --to mujoco --out servos.xml "
        "--recordings steps.csv chirp.csv",
    ),
    Command(
        "export-ranges",
        "sim2real.commands.export_ranges",
        _export_ranges,
        "sim2real export-ranges ranges.json --to isaaclab --out randomization.py",
    ),
    Command(
        "servos",
        "sim2real.commands.servos",
        _servos,
        "sim2real servos xl330_gain800 --joints pan tilt --out model.json",
    ),
)
"""In the order in which help lists them."""
