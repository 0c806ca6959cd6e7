"""``sim2real export-ranges``."""

from __future__ import annotations

import argparse

from sim2real.commands.write_export import write_export
from sim2real.exporters.ranges_isaaclab import isaaclab_ranges
from sim2real.exporters.ranges_mjlab import mjlab_ranges
from sim2real.exporters.ranges_newton import newton_ranges
from sim2real.exporters.ranges_playground import playground_ranges
from sim2real.output import check_writable
from sim2real.ranges.entry import read_ranges

TARGETS = {
    "isaaclab": isaaclab_ranges,
    "mjlab": mjlab_ranges,
    "newton": newton_ranges,
    "mujoco-playground": playground_ranges,
}


def run(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    check_writable(options.out)
    export = TARGETS[options.to](read_ranges(options.ranges))
    return write_export(export, options)
