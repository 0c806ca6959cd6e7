"""``sim2real export-ranges``."""

from __future__ import annotations

import argparse
import sys

from sim2real.exporters.ranges_isaaclab import isaaclab_ranges
from sim2real.exporters.ranges_playground import playground_ranges
from sim2real.output import check_writable, write_whole
from sim2real.ranges.entry import read_ranges

TARGETS = {"isaaclab": isaaclab_ranges, "mujoco-playground": playground_ranges}


def run(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what that simulator lacks."""
    check_writable(options.out)
    export = TARGETS[options.to](read_ranges(options.ranges))
    write_whole(options.out, export.text)
    options.result = {"file": str(options.out), "not_expressed": [*map(str, export.left_out)]}
    print(f"{options.out}: for {options.to}")
    if export.left_out:
        print("not expressed there (the file says so too):")
        sys.stdout.writelines(f"  {line}\n" for line in export.left_out)
    return 0
