"""``sim2real export-servo``."""

from __future__ import annotations

import argparse

from sim2real.commands.write_export import write_export
from sim2real.errors import InputError
from sim2real.exporters.simulators import TARGETS
from sim2real.model import read_model
from sim2real.output import check_writable
from sim2real.recording import read_recording
from sim2real.robot import read_robot


def run(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator; print what it does not express.

    Joints with effects that it lacks are refitted without them; the errors are printed.
    """
    check_writable(options.out)
    model = read_model(options.model)
    robot = read_robot(options.robot) if options.robot else None
    recordings = [read_recording(path) for path in options.recordings]
    for recording in recordings:
        if not set(recording.joints) & set(model.joints):
            found = f"joints {', '.join(recording.joints)}"
            raise InputError(recording.file, "joints", found, f"one of {', '.join(model.joints)}")
    if options.to == "mujoco":
        from sim2real.exporters.mujoco_bench import mujoco_export

        export, result, agreement = mujoco_export(model, recordings, robot, options.which)
        return write_export(export, options, result, agreement)
    target = TARGETS[options.to]
    if options.to == "json":  # it has everything
        return write_export(target.write(model, robot), options)
    from sim2real.exporters.nearest import nearest

    result = nearest(model, target.expressed, recordings, robot, which=options.which)
    return write_export(target.write(result.model, robot, result.dropped), options, result)
