"""Loads of the joints of a design, as its options state them."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.design.plan import designed_joints
from sim2real.errors import InputError
from sim2real.importers.options import loads_of
from sim2real.model import Model
from sim2real.recording import Load
from sim2real.robot import Robot


def stated_loads(
    robot: Robot,
    model: Model | None,
    inertia: Sequence[str] | None,
    pendulum: Sequence[str] | None,
) -> dict[str, Load]:
    """Loads by joint from ``J=KGM2`` and ``J=KG,M``, see ``importers.options.loads_of``.

    Raises:
        InputError: If an option is malformed, or the robot has no joint of the model.
    """
    joints = designed_joints(robot, model)
    if not joints:
        found = f"the joints {', '.join(model.joints) if model else ''}"
        known = ", ".join(joint.name for joint in robot.joints)
        raise InputError("model", "joints", found, f"some of the robot's: {known}")
    return loads_of(inertia, pendulum, joints)
