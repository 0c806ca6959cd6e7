"""One command of the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Command(NamedTuple):
    """One command.

    Attributes:
        name: As it is typed.
        module: Imported when it runs; its ``run(options)`` gives the exit status, and may set
            ``options.result``: what ``--json`` prints where no JSON file is written.
        add: Adds its options to a parser.
        example: One call of it.
        resumes: Whether the same call goes on where an interrupt left it.
    """

    name: str
    module: str
    add: Callable[[argparse.ArgumentParser], None]
    example: str
    resumes: bool = False


def add_recordings(command: argparse.ArgumentParser) -> None:
    """The recordings that a command reads."""
    command.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="recordings (NAME.csv with NAME.json in the same folder)",
    )


def add_former(command: argparse.ArgumentParser, name: str, stands_for: str) -> None:
    """A name that an option had before; it still works, and help does not show it."""
    command.add_argument(
        name, dest=stands_for, type=Path, default=argparse.SUPPRESS, help=argparse.SUPPRESS
    )
