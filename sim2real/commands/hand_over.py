"""The end of a command that exports: the file for another tool, and what that tool lacks."""

from __future__ import annotations

import argparse
import sys

from sim2real.exporters.actuator import Export
from sim2real.output import write_whole


def hand_over(export: Export, options: argparse.Namespace) -> int:
    """Write the text to ``options.out``; say for which tool, and what is not expressed there."""
    write_whole(options.out, export.text)
    options.result = {"file": str(options.out), "not_expressed": [*map(str, export.left_out)]}
    print(f"{options.out}: for {options.to}")
    if export.left_out:
        print("not expressed there (the file says so too):")
        sys.stdout.writelines(f"  {line}\n" for line in export.left_out)
    return 0
