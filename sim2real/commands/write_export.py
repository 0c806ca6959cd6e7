"""Output of the export commands: the file for another tool, and what the tool lacks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from sim2real.exporters.actuator import Export
from sim2real.output import write_whole

if TYPE_CHECKING:
    from sim2real.exporters.mujoco_bench import Agreement
    from sim2real.exporters.nearest import Nearest


def write_export(
    export: Export,
    options: argparse.Namespace,
    nearest: Nearest | None = None,
    agreement: Sequence[Agreement] = (),
) -> int:
    """Write the text to ``options.out``; print the tool and what is not expressed.

    Args:
        export: The file for the other tool, and what that tool lacks.
        options: ``out``: the file to write; ``to``: the tool. ``result`` is set.
        nearest: The model that the tool expresses, with errors of refits and of the plain servo.
        agreement: Differences of the tool's simulation from the model or a recording.
    """
    write_whole(options.out, export.text)
    refits, compared = (nearest.refits, nearest.compared) if nearest else ((), ())
    options.result = {
        "file": str(options.out),
        "not_expressed": [*map(str, export.left_out)],
        "refitted": [asdict(refit) for refit in refits],
        "compared": [asdict(entry) for entry in compared],
        "agreement": [asdict(entry) for entry in agreement],
    }
    print(f"{options.out}: for {options.to}")
    if export.left_out:
        print("not expressed there (the file says so too):")
        sys.stdout.writelines(f"  {line}\n" for line in export.left_out)
    for cost in (*compared, *refits, *agreement):
        print(cost)
    return 0
