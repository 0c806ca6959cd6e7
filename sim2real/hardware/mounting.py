"""Mounting of servos in joints: identity on the bus, conversion of ticks to angles."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim2real.errors import InputError
from sim2real.hardware.lx import CENTRE_TICKS, LARGEST_ID, LARGEST_TICKS, TICK_RAD
from sim2real.robot import Joint, Robot


@dataclass(frozen=True)
class Mounting:
    """A servo in its joint: angle = sign (ticks - 500 - trim) 0.24 degrees.

    Attributes:
        joint: The joint, with its limits.
        servo_id: The servo's identity on the bus.
        trim_ticks: Ticks at angle 0, minus 500.
        sign: -1 if servo and joint turn in opposite directions.
    """

    joint: Joint
    servo_id: int
    trim_ticks: int = 0
    sign: int = 1

    def angle(self, ticks: int) -> float:
        """Angle of the joint in rad at ``ticks``."""
        return self.sign * (ticks - CENTRE_TICKS - self.trim_ticks) * TICK_RAD

    def ticks(self, angle: float) -> int:
        """The nearest tick to ``angle`` within the joint limits."""
        low, high = self.joint.limits_rad
        steps = round(min(max(angle, low), high) / TICK_RAD)
        steps = min(max(steps, math.ceil(low / TICK_RAD)), math.floor(high / TICK_RAD))
        return CENTRE_TICKS + self.trim_ticks + self.sign * steps


def mount(
    robot: Robot,
    ids: list[int],
    *,
    joints: list[str] | None = None,
    trim_ticks: list[int] | None = None,
    reverse: list[str] | None = None,
) -> tuple[Mounting, ...]:
    """Assign servos to the joints of a robot.

    Args:
        robot: The robot.
        ids: Identity of the servo of each joint.
        joints: Names of the joints; default: all of the robot.
        trim_ticks: Trim of each servo; default: 0.
        reverse: Names of the joints whose servo turns in the opposite direction.

    Raises:
        InputError: If the numbers do not match, a name or an identity is wrong, or the limits of a
            joint exceed the range of its servo.
    """
    names = joints or [joint.name for joint in robot.joints]
    trims = trim_ticks or [0] * len(names)
    names_known = ", ".join(joint.name for joint in robot.joints)
    for name in [*names, *(reverse or [])]:
        if robot.joint(name) is None:
            raise InputError(
                robot.path or robot.name, "joints", f"no joint {name!r}", f"some of {names_known}"
            )
    for option, numbers in (("--ids", ids), ("--trim", trims)):
        if len(numbers) != len(names):
            expected = f"{len(names)}, for {', '.join(names)}"
            raise InputError(option, "", f"{len(numbers)} numbers", expected)
    if len(set(ids)) != len(ids) or not all(0 <= k <= LARGEST_ID for k in ids):
        given_ids = ", ".join(str(k) for k in ids)
        raise InputError("--ids", "", given_ids, f"different numbers from 0 to {LARGEST_ID}")
    return tuple(
        _mounting(robot, name, servo_id, trim, -1 if name in (reverse or []) else 1)
        for name, servo_id, trim in zip(names, ids, trims, strict=True)
    )


def _mounting(robot: Robot, name: str, servo_id: int, trim: int, sign: int) -> Mounting:
    joint = robot.joint(name)
    assert joint is not None
    mounting = Mounting(joint, servo_id, trim, sign)
    ends = [mounting.angle(0), mounting.angle(LARGEST_TICKS)]
    low, high = joint.limits_rad
    if low < min(ends) or high > max(ends):
        limits = f"{low:g} to {high:g} rad for {name}"
        expected = f"limits that the servo reaches, {min(ends):.3f} to {max(ends):.3f} rad"
        raise InputError(robot.path or robot.name, "joints.limits_rad", limits, expected)
    return mounting
