"""``sim2real completion``."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.cli import parser
from sim2real.errors import library


def run(options: argparse.Namespace) -> int:
    """Print the completion script of a shell, with file names for options that take files."""
    shtab = library("shtab", "completion")
    root = parser()
    for command in _commands(root):
        for action in command._actions:
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(root, shell=options.shell))
    return 0


def _commands(root: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    several = [a for a in root._actions if isinstance(a, argparse._SubParsersAction)]
    return [command for action in several for command in action.choices.values()]
