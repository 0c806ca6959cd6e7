"""Mounting of servos in joints: which servo is in which joint, conversion of ticks to angles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim2real.errors import InputError
from sim2real.hardware.servo_bus import BusServo, Stopped
from sim2real.robot import Joint, Robot


@dataclass(frozen=True)
class Mounting:
    """A servo in its joint: angle = sign (ticks - centre - trim) angle of a tick.

    The trim is the ticks at angle 0, minus those at the servo's centre; the sign is -1 if servo and
    joint turn in opposite directions.
    """

    joint: Joint
    servo: BusServo
    trim_ticks: int = 0
    sign: int = 1

    @property
    def servo_id(self) -> int:
        """The servo's identity on the bus."""
        return self.servo.servo_id

    def angle(self, ticks: int) -> float:
        """Angle of the joint in rad at ``ticks``."""
        return self.sign * self.servo.angle(ticks - self.trim_ticks)

    def ticks(self, angle: float) -> int:
        """The nearest tick to ``angle`` within the joint limits."""
        low, high = self.joint.limits_rad
        tick = self.servo.tick_rad
        steps = round(min(max(angle, low), high) / tick)
        steps = min(max(steps, math.ceil(low / tick)), math.floor(high / tick))
        return self.servo.centre_ticks + self.trim_ticks + self.sign * steps

    def within(self, ticks: int) -> int:
        """The nearest set-point that the servo accepts."""
        return min(max(ticks, self.servo.lowest_ticks), self.servo.largest_ticks)

    def check_temperature(self, temperature_C: float, hottest_C: float) -> None:
        """Raise ``Stopped`` if the servo is too hot; NaN is not."""
        if temperature_C > hottest_C:
            found = f"{self.joint.name}'s servo is at {temperature_C:.0f} C"
            raise Stopped(f"{found}, above {hottest_C:.0f} C")


@dataclass(frozen=True)
class Wiring:
    """Which servo is in which joint; by default all joints of the robot, with trims of 0."""

    ids: Sequence[int]
    joints: Sequence[str] | None = None
    trim_ticks: Sequence[int] | None = None
    reverse: Sequence[str] | None = None

    def check(self, robot: Robot) -> list[str]:
        """Names of the joints, checked before the port is opened; ``InputError`` if wrong."""
        names = list(self.joints or [joint.name for joint in robot.joints])
        known = ", ".join(joint.name for joint in robot.joints)
        for name in [*names, *(self.reverse or [])]:
            if robot.joint(name) is None:
                file = robot.path or robot.name
                raise InputError(file, "joints", f"no joint {name!r}", f"some of {known}")
        trims = len(names) if self.trim_ticks is None else len(self.trim_ticks)
        for option, found in (("--ids", len(self.ids)), ("--trim", trims)):
            if found != len(names):
                expected = f"{len(names)}, for {', '.join(names)}"
                raise InputError(option, "", f"{found} numbers", expected)
        return names


def mount(robot: Robot, servos: Sequence[BusServo], wiring: Wiring) -> tuple[Mounting, ...]:
    """Assign servos to the joints of a robot; ``InputError`` if one does not fit."""
    names = wiring.check(robot)
    mountings = []
    for name, servo, trim in zip(names, servos, wiring.trim_ticks or [0] * len(names), strict=True):
        joint = robot.joint(name)
        assert joint is not None
        mounting = Mounting(joint, servo, trim, -1 if name in (wiring.reverse or []) else 1)
        ends = [mounting.angle(servo.lowest_ticks), mounting.angle(servo.largest_ticks)]
        low, high = joint.limits_rad
        if low < min(ends) or high > max(ends):
            limits = f"{low:g} to {high:g} rad for {name}"
            expected = f"limits that the servo reaches, {min(ends):.3f} to {max(ends):.3f} rad"
            raise InputError(robot.path or robot.name, "joints.limits_rad", limits, expected)
        mountings.append(mounting)
    return tuple(mountings)
