"""``sim2real export-servo`` and ``sim2real export-ranges``: files for other simulators."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from sim2real.errors import InputError
from sim2real.exporters.actuator import Export
from sim2real.exporters.ranges import TARGETS as RANGES
from sim2real.exporters.simulators import TARGETS
from sim2real.model import read_model
from sim2real.output import check_writable, write_whole
from sim2real.ranges.entry import read_ranges
from sim2real.recording import read_recording
from sim2real.robot import read_robot

if TYPE_CHECKING:
    from sim2real.exporters.mujoco_bench import Agreement
    from sim2real.exporters.nearest import Nearest


def export_servo(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator, refitted without effects that it lacks."""
    check_writable(options.out)
    model = read_model(options.model)
    robot = read_robot(options.robot) if options.robot else None
    recordings = [read_recording(path) for path in options.recordings or ()]
    for recording in recordings:
        if not set(recording.joints) & set(model.joints):
            found = f"joints {', '.join(recording.joints)}"
            raise InputError(recording.file, "joints", found, f"one of {', '.join(model.joints)}")
    if options.to == "mujoco":
        from sim2real.exporters.mujoco_bench import mujoco_export

        export, result, agreement = mujoco_export(model, recordings, robot, options.which)
        return _written(export, options, result, agreement)
    target = TARGETS[options.to]
    if options.to == "json":  # it has everything
        return _written(target.write(model, robot), options)
    from sim2real.exporters.nearest import nearest

    result = nearest(model, target.expressed, recordings, robot, which=options.which)
    return _written(target.write(result.model, robot, result.dropped), options, result)


def export_ranges(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    check_writable(options.out)
    return _written(RANGES[options.to].write(read_ranges(options.ranges)), options)


def _written(
    export: Export,
    options: argparse.Namespace,
    nearest: Nearest | None = None,
    agreement: Sequence[Agreement] = (),
) -> int:
    """Write the text; print what it lacks, the errors of refits, and differences of the tool."""
    beside = {options.out.with_suffix(ending): text for ending, text in export.beside.items()}
    if options.out in beside:
        raise InputError(
            options.out, "--out", options.out.suffix, "another ending: it names the C code"
        )
    for path in beside:
        check_writable(path)
    for path, text in {options.out: export.text, **beside}.items():
        write_whole(path, text)
    refits, compared = (nearest.refits, nearest.compared) if nearest else ((), ())
    options.result = {
        "file": str(options.out),
        "not_expressed": [*map(str, export.left_out)],
        "refitted": [asdict(refit) for refit in refits],
        "compared": [asdict(entry) for entry in compared],
        "agreement": [asdict(entry) for entry in agreement],
    }
    print(f"{', '.join(map(str, (options.out, *beside)))}: for {options.to}")
    if export.left_out:
        print("not expressed there (the file says so too):")
        sys.stdout.writelines(f"  {line}\n" for line in export.left_out)
    for cost in (*compared, *refits, *agreement):
        print(cost)
    return 0
