"""The options ``--rerun`` and ``--mcap``: files for viewers of time series."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from sim2real.errors import InputError
from sim2real.output import check_writable
from sim2real.viewers.mcap_file import mcap_library, write_mcap
from sim2real.viewers.rerun_file import rerun_library, write_rerun
from sim2real.viewers.signal_group import Scene

_WRITERS = {
    "rerun": (".rrd", rerun_library, write_rerun),
    "mcap": (".mcap", mcap_library, write_mcap),
}


def check_views(options: argparse.Namespace) -> None:
    """Check, before any computation, that the files asked for can be written.

    Raises:
        InputError: If a name has another ending, a folder cannot be written, or a library is
            missing.
    """
    for name, (ending, library, _) in _WRITERS.items():
        path = getattr(options, name)
        if path is None:
            continue
        if path.suffix != ending:
            raise InputError(path, f"--{name}", f"the ending {path.suffix!r}", ending)
        check_writable(path)
        library()


def write_views(options: argparse.Namespace, scene: Callable[[], Scene]) -> None:
    """Write the files asked for; ``scene`` is called only if there is one."""
    wanted = [name for name in _WRITERS if getattr(options, name) is not None]
    if not wanted:
        return
    shown = scene()
    for name in wanted:
        print(f"{name}: {_WRITERS[name][2](shown, getattr(options, name))}")
