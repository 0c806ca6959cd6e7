"""Recordings of an arm with the load that its motion exerts on each shaft."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arm.coupled import coupled_motion, loads_on
from sim2real.arm.description import Arm
from sim2real.arm.joint_motion import ArmMotion, corrected_motion, measured_motion
from sim2real.arm.multibody import Multibody
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.parameters import in_context, joint_row
from sim2real.servo.trace import context_of


def with_arm_loads(
    recordings: Sequence[Recording], robot: Robot, model: Model | None = None
) -> list[Recording]:
    """The recordings, with loads that vary with time if the robot is an arm.

    Args:
        recordings: Recordings of the arm's joints, moving together.
        robot: The robot.
        model: Fitted servos, whose prediction supplies the fast part of the motion; without it
            the motion is that of smoothed measured angles.

    Raises:
        InputError: If a recording states loads besides the URDF, or the URDF is not usable.
    """
    if robot.arm is None:
        return list(recordings)
    multibody, out = Multibody(robot.arm), []
    for recording in recordings:
        for name in robot.arm.names:
            if name in recording.loads:
                found = f"a load of {name}, which the URDF in {robot.path} has as well"
                raise InputError(recording.file, f"loads.{name}", found, "one of the two")
        motion = _motion(multibody, recording, model)
        loads = dict(zip(robot.arm.names, loads_on(multibody, motion), strict=True))
        varying = {name: load for name, load in loads.items() if name in recording.joints}
        out.append(replace(recording, varying_loads=varying))
    return out


def predicted_arm(
    arm: Arm,
    joints: Mapping[str, JointModel],
    t: Array,
    command: Mapping[str, Array],
    *,
    multibody: Multibody | None = None,
) -> tuple[ArmMotion, dict[str, Array]]:
    """Motion and measured angles of an arm that a model predicts from commands alone.

    Joints that are not in the model follow their command; without a command they stay at the
    URDF's zero.

    Args:
        arm: The arm.
        joints: Its fitted servos.
        t: Times in s, shape (T,).
        command: Set-points in rad by joint, each of shape (T,).
        multibody: Dynamics of the arm, if they have been set up already.

    Returns:
        The motion of all joints, and the angles in rad of the commanded ones, each of shape (T,).

    Raises:
        InputError: If the simulation does not converge.
    """
    rows: list[Array | None] = []
    sent = np.empty((t.size, len(arm.joints)))
    for j, joint in enumerate(arm.joints):
        fitted = joints.get(joint.name) if joint.name in command else None
        rows.append(None if fitted is None else joint_row(fitted, None, f"model, {joint.name}"))
        sent[:, j] = command.get(joint.name, np.full(t.size, joint.zero_rad))
    motion, angles = coupled_motion(multibody or Multibody(arm), rows, t, sent)
    by_name = dict(zip(arm.names, angles.T, strict=True))
    return motion, {name: by_name[name] for name in command}


def _motion(multibody: Multibody, recording: Recording, model: Model | None) -> ArmMotion:
    arm = multibody.arm
    if model is None:
        rest = np.array([joint.zero_rad for joint in arm.joints])
        return measured_motion(recording, arm.names, rest)
    commands = {name: x for name, x in recording.commands.items() if name in arm.names}
    context = context_of(recording)
    joints = {name: in_context(joint, **context) for name, joint in model.joints.items()}
    predicted, _ = predicted_arm(arm, joints, recording.t, commands, multibody=multibody)
    return corrected_motion(predicted, recording, arm.names)
