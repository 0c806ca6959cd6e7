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
from sim2real.exporters.simulators import STEPS, TARGETS
from sim2real.model import read_model
from sim2real.output import check_writable, write_whole
from sim2real.ranges.entry import read_ranges
from sim2real.recording import read_recording
from sim2real.robot import read_robot

if TYPE_CHECKING:
    from sim2real.exporters.costs import Cost
    from sim2real.exporters.mjcf import StepResponse
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
    if options.into or options.joint:
        if options.to != "mujoco" or not (options.into and options.joint):
            found = f"--to {options.to}" if options.to != "mujoco" else "one of both"
            raise InputError("--into, --joint", "", found, "both, with --to mujoco")
        from sim2real.exporters.mjcf import into_robot

        given = options.into, options.joint, options.out, model, recordings, options.which
        export, result, steps = into_robot(*given)
        return _written(export, options, result, steps)
    if options.to == "mujoco":
        from sim2real.exporters.mujoco_bench import mujoco_export

        export, result, agreement = mujoco_export(model, recordings, robot, options.which)
        return _written(export, options, result, agreement)
    target = TARGETS[options.to]
    if options.to == "json":  # it has everything
        return _written(target.write(model, robot), options)
    from sim2real.exporters.costs import costs
    from sim2real.exporters.nearest import nearest

    result = nearest(model, target.expressed, recordings, robot, which=options.which)
    export = target.write(result.model, robot, result.dropped)
    whole, proportional = target.partly.get("latency") is STEPS, options.to == "isaaclab-bam"
    lost = costs(result.model, whole_steps=whole, proportional=proportional)
    return _written(export, options, result, lost)


def export_ranges(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    check_writable(options.out)
    return _written(RANGES[options.to].write(read_ranges(options.ranges)), options)


def _written(
    export: Export,
    options: argparse.Namespace,
    nearest: Nearest | None = None,
    agreement: Sequence[Agreement | StepResponse | Cost] = (),
) -> int:
    """Write the text; print what it lacks, the errors of refits, and differences of the tool."""
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
