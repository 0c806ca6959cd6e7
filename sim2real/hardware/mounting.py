"""Mounting of servos in joints: which servo is in which joint, conversion of ticks to angles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim2real.errors import InputError
from sim2real.hardware.servo_bus import BusServo, Scale
from sim2real.robot import Joint, Robot


@dataclass(frozen=True)
class Mounting:
    """A servo in its joint: angle = sign (ticks - centre - trim) angle of a tick.

    Attributes:
        joint: The joint, with its limits.
        servo: The servo on the bus.
        trim_ticks: Ticks at angle 0, minus those at the servo's centre.
        sign: -1 if servo and joint turn in opposite directions.
    """

    joint: Joint
    servo: BusServo
    trim_ticks: int = 0
    sign: int = 1

    @property
    def servo_id(self) -> int:
        """The servo's identity on the bus."""
        return self.servo.servo_id

    @property
    def scale(self) -> Scale:
        """The servo's ticks."""
        return self.servo.scale

    def angle(self, ticks: int) -> float:
        """Angle of the joint in rad at ``ticks``."""
        return self.sign * self.scale.angle(ticks - self.trim_ticks)

    def ticks(self, angle: float) -> int:
        """The nearest tick to ``angle`` within the joint limits."""
        low, high = self.joint.limits_rad
        tick = self.scale.tick_rad
        steps = round(min(max(angle, low), high) / tick)
        steps = min(max(steps, math.ceil(low / tick)), math.floor(high / tick))
        return self.scale.centre_ticks + self.trim_ticks + self.sign * steps

    def within(self, ticks: int) -> int:
        """The nearest set-point that the servo accepts."""
        return min(max(ticks, self.scale.lowest_ticks), self.scale.largest_ticks)


def mount(
    robot: Robot,
    servos: Sequence[BusServo],
    *,
    joints: Sequence[str] | None = None,
    trim_ticks: Sequence[int] | None = None,
    reverse: Sequence[str] | None = None,
) -> tuple[Mounting, ...]:
    """Assign servos to the joints of a robot.

    Args:
        robot: The robot.
        servos: The servo of each joint.
        joints: Names of the joints; default: all of the robot.
        trim_ticks: Trim of each servo; default: 0.
        reverse: Names of the joints whose servo turns in the opposite direction.

    Raises:
        InputError: If the numbers do not match, a name is wrong, or the limits of a joint exceed
            the range of its servo.
    """
    names = check_joints(robot, len(servos), joints, trim_ticks, reverse)
    trims = trim_ticks or [0] * len(names)
    return tuple(
        _mounting(robot, name, servo, trim, -1 if name in (reverse or []) else 1)
        for name, servo, trim in zip(names, servos, trims, strict=True)
    )


def check_joints(
    robot: Robot,
    count: int,
    joints: Sequence[str] | None,
    trim_ticks: Sequence[int] | None,
    reverse: Sequence[str] | None,
) -> list[str]:
    """Names of the joints to which ``count`` servos are assigned.

    Raises:
        InputError: If the numbers do not match, or a name is wrong.
    """
    names = list(joints or [joint.name for joint in robot.joints])
    known = ", ".join(joint.name for joint in robot.joints)
    for name in [*names, *(reverse or [])]:
        if robot.joint(name) is None:
            raise InputError(
                robot.path or robot.name, "joints", f"no joint {name!r}", f"some of {known}"
            )
    trims = len(names) if trim_ticks is None else len(trim_ticks)
    for option, found in (("--ids", count), ("--trim", trims)):
        if found != len(names):
            expected = f"{len(names)}, for {', '.join(names)}"
            raise InputError(option, "", f"{found} numbers", expected)
    return names


def check_ids(ids: Sequence[int], largest: int) -> None:
    """Check that identities are different and exist on a bus.

    Raises:
        InputError: If not.
    """
    if not ids or len(set(ids)) != len(ids) or not all(0 <= k <= largest for k in ids):
        given = ", ".join(str(k) for k in ids) or "nothing"
        raise InputError("--ids", "", given, f"different numbers from 0 to {largest}")


def _mounting(robot: Robot, name: str, servo: BusServo, trim: int, sign: int) -> Mounting:
    joint = robot.joint(name)
    assert joint is not None
    mounting = Mounting(joint, servo, trim, sign)
    ends = [mounting.angle(servo.scale.lowest_ticks), mounting.angle(servo.scale.largest_ticks)]
    low, high = joint.limits_rad
    if low < min(ends) or high > max(ends):
        limits = f"{low:g} to {high:g} rad for {name}"
        expected = f"limits that the servo reaches, {min(ends):.3f} to {max(ends):.3f} rad"
        raise InputError(robot.path or robot.name, "joints.limits_rad", limits, expected)
    return mounting
