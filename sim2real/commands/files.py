"""The files that a command reads and writes, from its options; those for viewers."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim2real.errors import InputError, library
from sim2real.output import check_not_read, check_writable, is_stream, protect

if TYPE_CHECKING:
    from sim2real.viewers.scenes import Scene

WRITTEN = ("out", "plot", "video", "film", "rerun", "mcap")
"""Options whose file a command writes."""
_READ = {"track": ("video",)}
"""Of these, what a command reads."""
_VIEWS = {"rerun": (".rrd", "rerun"), "mcap": (".mcap", "mcap.writer")}
"""Ending and library of the files for viewers."""


def check_files(options: argparse.Namespace) -> None:
    """Declare all files that a command reads, none endless; it must write none of them."""
    writes = [name for name in WRITTEN if name not in _READ.get(options.command, ())]
    for name, value in vars(options).items():
        if name not in writes:
            for path in _paths(value):
                if path.is_fifo() or (isinstance(value, Path) and path.is_char_device()):
                    kind = "a pipe" if path.is_fifo() else "a device"
                    raise InputError(path, "", kind, "a file")
                protect(path)
    named: set[str] = set()
    for name in writes:
        for path in _paths(getattr(options, name, None)):
            check_not_read(path)
        if isinstance(out := getattr(options, name, None), Path) and not is_stream(out):
            with contextlib.suppress(FileNotFoundError):  # of a working directory that is gone
                if (place := os.path.realpath(out)) in named:
                    raise InputError(out, f"--{name}", "a file that is named twice", "another file")
                named.add(place)


def _paths(value: object) -> Iterator[Path]:
    """The files that the value of an option names."""
    for entry in value if isinstance(value, list | tuple) else [value]:
        if isinstance(entry, str | Path) and "\0" not in str(entry):
            path = Path(entry)
            yield path
            if path.suffix == ".csv":
                yield path.with_suffix(".json")


def check_written(options: argparse.Namespace) -> None:
    """Raise InputError, before any computation, unless all files of a command can be written."""
    for name in WRITTEN:
        if (path := getattr(options, name, None)) is None:
            continue
        if name in _VIEWS:
            ending, module = _VIEWS[name]
            if path.suffix != ending:
                raise InputError(path, f"--{name}", f"the ending {path.suffix!r}", ending)
            library(module, f"--{name}")
        check_writable(path)


def save_plot(result: Any, path: Path | None) -> None:  # noqa: ANN401 - with a method plot
    """Write the plot of a result, if a file for it is named."""
    if path is not None:
        from sim2real.report.drawing import save_png

        save_png(result.plot(), path)


def write_views(options: argparse.Namespace, scene: Callable[[], Scene]) -> None:
    """Write the files for viewers; ``scene`` is called only if there is one."""
    wanted = [name for name in _VIEWS if getattr(options, name) is not None]
    if not wanted:
        return
    from sim2real.viewers.scenes import write_mcap, write_rerun

    shown = scene()
    for name in wanted:
        write = {"rerun": write_rerun, "mcap": write_mcap}[name]
        print(f"{name}: {write(shown, getattr(options, name))}")
