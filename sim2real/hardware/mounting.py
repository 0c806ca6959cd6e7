"""Mounting of servos in joints: which servo is in which joint, conversion of ticks to angles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim2real.errors import InputError
from sim2real.hardware.servo_bus import BusServo, Stopped
from sim2real.robot import Joint, Robot


@dataclass(frozen=True)
class Place:
    """Which servo is in a joint.

    The trim is the ticks at angle 0, minus those at the servo's centre; the sign is -1 if servo and
    joint turn in opposite directions.
    """

    joint: Joint
    servo_id: int
    trim_ticks: int
    sign: int


@dataclass(frozen=True)
class Mounting(Place):
    """A servo in its joint: angle = sign (ticks - centre - trim) angle of a tick."""

    servo: BusServo

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


def places(
    robot: Robot,
    ids: Sequence[int],
    joints: Sequence[str] | None = None,
    trim_ticks: Sequence[int] | None = None,
    reverse: Sequence[str] | None = None,
) -> list[Place]:
    """Places of servos in joints of a robot, by default in all; ``InputError`` if they differ."""
    names = list(joints or [joint.name for joint in robot.joints])
    known = {joint.name: joint for joint in robot.joints}
    for name in [*names, *(reverse or [])]:
        if name not in known:
            file, expected = robot.path or robot.name, f"some of {', '.join(known)}"
            raise InputError(file, "joints", f"no joint {name!r}", expected)
    trims = [0] * len(names) if trim_ticks is None else trim_ticks
    for option, given in (("--ids", ids), ("--trim", trims)):
        if len(given) != len(names):
            expected = f"{len(names)}, for {', '.join(names)}"
            raise InputError(option, "", f"{len(given)} numbers", expected)
    signs = [-1 if name in (reverse or []) else 1 for name in names]
    wired = zip(names, ids, trims, signs, strict=True)
    return [Place(known[name], servo_id, trim, sign) for name, servo_id, trim, sign in wired]
