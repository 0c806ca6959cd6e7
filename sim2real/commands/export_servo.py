"""``sim2real export-servo``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple, Protocol

from sim2real.commands.write_export import write_export
from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.exporters import actuators_json, genesis, isaaclab, mjlab, mujoco, newton, urdf
from sim2real.exporters.actuator import SATURATION, Export, LeftOut, limit_effects
from sim2real.model import JointModel, Model, read_model
from sim2real.output import check_writable
from sim2real.recording import read_recording
from sim2real.robot import Robot, read_robot
from sim2real.servo.parameters import SOFT


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
        from sim2real.exporters.mujoco_refit import mujoco_refit

        checked = mujoco_refit(model, recordings, robot, options.which)
        return write_export(checked.export, options, checked.expressible, checked.agreement)
    target = TARGETS[options.to]
    if options.to == "json":  # it has everything
        return write_export(target.write(model, robot), options)
    from sim2real.exporters.expressible import expressible

    nearest = expressible(model, target.expressed, recordings, robot, which=options.which)
    export = target.write(nearest.model, robot, nearest.dropped)
    return write_export(export, options, nearest)
