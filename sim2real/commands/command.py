"""One command of the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Command(NamedTuple):
    """One command.

    Attributes:
        name: Name on the command line.
        module: Imported when it runs; its ``run(options)`` returns the exit status, and may set
            ``options.result``, which ``--json`` prints if no JSON file is written.
        add: Adds its options to a parser.
        example: An example call.
        resumes: Whether the same call resumes after an interrupt.
    """

    name: str
    module: str
    add: Callable[[argparse.ArgumentParser], None]
    example: str
    resumes: bool = False


def add_file(
    command: argparse.ArgumentParser, name: str, metavar: str, text: str, *, required: bool = False
) -> None:
    """Add a file or folder: an option, or a positional argument where its name has no dashes."""
    command.add_argument(name, type=Path, metavar=metavar, help=text).required |= required


def add_number(
    command: argparse.ArgumentParser, name: str, metavar: str, text: str, default: float
) -> None:
    """Add a number, of the type of its default, which the help states."""
    text += f" (default {default:g})"
    command.add_argument(name, type=type(default), default=default, metavar=metavar, help=text)


def add_flag(command: argparse.ArgumentParser, name: str, text: str) -> None:
    """Add an option without a value."""
    command.add_argument(name, action="store_true", help=text)


def add_recordings(command: argparse.ArgumentParser) -> None:
    """The recordings that a command reads."""
    command.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="recordings (NAME.csv with NAME.json in the same folder)",
    )


def add_views(command: argparse.ArgumentParser) -> None:
    """The files for viewers of time series that a command writes if asked to."""
    add_file(command, "--rerun", "RRD", "file of all signals for Rerun (FILE.rrd)")
    add_file(command, "--mcap", "MCAP", "file of all signals for Foxglove (FILE.mcap)")


def add_former(command: argparse.ArgumentParser, name: str, stands_for: str) -> None:
    """Add a former name of an option, which still works and is not shown in help."""
    command.add_argument(
        name, dest=stands_for, type=Path, default=argparse.SUPPRESS, help=argparse.SUPPRESS
    )
