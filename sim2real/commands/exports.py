"""``sim2real export-servo`` and ``sim2real export-ranges``: files for other simulators."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, NamedTuple, Protocol

from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.exporters import actuators_json, genesis, isaaclab, mjlab, mujoco, newton, urdf
from sim2real.exporters.actuator import SATURATION, Export, LeftOut, limit_effects
from sim2real.exporters.ranges_isaaclab import isaaclab_ranges
from sim2real.exporters.ranges_mjlab import mjlab_ranges
from sim2real.exporters.ranges_newton import newton_ranges
from sim2real.exporters.ranges_playground import playground_ranges
from sim2real.model import JointModel, Model, read_model
from sim2real.output import check_writable, write_whole
from sim2real.ranges.entry import read_ranges
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot
from sim2real.servo.parameters import SOFT

if TYPE_CHECKING:
    from sim2real.exporters.expressible import Expressible
    from sim2real.exporters.mujoco_refit import Agreement


class Write(Protocol):
    """Writes a model's actuators as the text of a target."""

    def __call__(
        self, model: Model, robot: Robot | None = None, dropped: Sequence[LeftOut] = ()
    ) -> Export:
        """The text, and what it does not express."""


class Target(NamedTuple):
    """A simulator or format: its writer, and the effects of a joint that it expresses."""

    write: Write
    expressed: Callable[[JointModel], Collection[str]]


def _always(*effects: str) -> Callable[[JointModel], Collection[str]]:
    return lambda joint: {*effects, *limit_effects(joint)}


TARGETS = {
    "mujoco": Target(mujoco.mujoco, mujoco.expressed),
    "isaaclab": Target(isaaclab.isaaclab, _always(*isaaclab.HAS, SATURATION)),
    "mjlab": Target(mjlab.mjlab, _always(*mjlab.HAS, *SOFT)),
    "newton": Target(newton.newton, _always(*newton.HAS, *SOFT, SATURATION)),
    "genesis": Target(genesis.genesis, _always(*genesis.HAS)),
    "urdf": Target(urdf.urdf, _always(*urdf.HAS)),
    "json": Target(actuators_json.actuators_json, _always(*(effect.name for effect in CATALOGUE))),
}
RANGES = {
    "isaaclab": isaaclab_ranges,
    "mjlab": mjlab_ranges,
    "newton": newton_ranges,
    "mujoco-playground": playground_ranges,
}


def export_servo(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator; print what it does not express.

    Joints with effects that it lacks are refitted without them; the errors are printed.
    """
    check_writable(options.out)
    model = read_model(options.model)
    robot = read_robot(options.robot) if options.robot else None
    recordings = [read_recording(path) for path in options.recordings or ()]
    for recording in recordings:
        if not set(recording.joints) & set(model.joints):
            found = f"joints {', '.join(recording.joints)}"
            raise InputError(recording.file, "joints", found, f"one of {', '.join(model.joints)}")
    if options.to == "mujoco":
        from sim2real.exporters.mujoco_refit import mujoco_refit

        checked = mujoco_refit(model, recordings, robot, options.which)
        return _written(checked.export, options, checked.expressible, checked.agreement)
    target = TARGETS[options.to]
    if options.to == "json":  # it has everything
        return _written(target.write(model, robot), options)
    from sim2real.exporters.expressible import expressible

    nearest = expressible(model, target.expressed, recordings, robot, which=options.which)
    return _written(target.write(nearest.model, robot, nearest.dropped), options, nearest)


def export_ranges(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    check_writable(options.out)
    return _written(RANGES[options.to](read_ranges(options.ranges)), options)


def _written(
    export: Export,
    options: argparse.Namespace,
    nearest: Expressible | None = None,
    agreement: Sequence[Agreement] = (),
) -> int:
    """Write the text; print what it lacks, the errors of refits, and differences of the tool."""
    write_whole(options.out, export.text)
    refits, compared = (nearest.refits, nearest.compared) if nearest else ((), ())
    options.result = {
        "file": str(options.out),
        "not_expressed": [*map(str, export.left_out)],
        "refitted": [asdict(refit) for refit in refits],
        "compared": [asdict(entry) for entry in compared],
        "agreement": [entry.content() for entry in agreement],
    }
    print(f"{options.out}: for {options.to}")
    if export.left_out:
        print("not expressed there (the file says so too):")
        sys.stdout.writelines(f"  {line}\n" for line in export.left_out)
    for cost in (*compared, *refits, *agreement):
        print(cost)
    return 0
