"""Loads of the joints of a design, as its options state them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.design.plan import designed_joints
from sim2real.errors import InputError
from sim2real.importers.loads import with_loads
from sim2real.model import Model
from sim2real.recording import Load, Recording
from sim2real.robot import Robot


def stated_loads(
    robot: Robot,
    model: Model | None,
    inertia: Sequence[str] | None,
    pendulum: Sequence[str] | None,
) -> dict[str, Load]:
    """Loads by joint from ``J=KGM2`` and ``J=KG,M``, see ``importers.loads.with_loads``.

    Raises:
        InputError: If an option is malformed, or the robot has no joint of the model.
    """
    joints = designed_joints(robot, model)
    if not joints:
        found = f"the joints {', '.join(model.joints) if model else ''}"
        known = ", ".join(joint.name for joint in robot.joints)
        raise InputError("model", "joints", found, f"some of the robot's: {known}")
    none = np.zeros((0, len(joints)))
    blank = Recording("next", "servo", tuple(joints), np.zeros(0), none, none)
    return dict(with_loads(blank, inertia, pendulum).loads)
