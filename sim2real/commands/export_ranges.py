"""``sim2real export-ranges``."""

from __future__ import annotations

import argparse

from sim2real.commands.write_export import write_export
from sim2real.exporters.ranges import TARGETS
from sim2real.output import check_writable
from sim2real.ranges.entry import read_ranges


def run(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    check_writable(options.out)
    return write_export(TARGETS[options.to].write(read_ranges(options.ranges)), options)
