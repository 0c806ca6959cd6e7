"""What a recording may be: limits of the commands of a joint, and contexts that a bench offers.

Commands that keep the limits are played by ``sim2real record`` without a change.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sim2real.arrays import Array, Integers
from sim2real.diagnose.rival_sets import JointRivals
from sim2real.errors import InputError
from sim2real.recording import Load, read_load
from sim2real.robot import Joint, Robot
from sim2real.structured import Fields, read_toml

PERIOD_S = 0.02
"""Sample period of the recorder, s."""
_FINEST_RAD, _FINEST_STEP_RAD = 1e-4, 1e-6
"""Resolution of the commands where the data sheet states no position step, and the finest, rad."""
CONTINUOUS_SHARE = 0.5
"""Largest root mean square of the torque, as a share of the stall torque.

The windings heat with the square of the torque; at half of it they dissipate a quarter of what they
do at stall."""


@dataclass(frozen=True)
class CommandLimits:
    """Limits of the commands of one joint."""

    joint: str  # name of the joint
    position_rad: tuple[float, float]  # smallest and largest set-point, rad
    rate_rad_s: float  # largest rate of the set-point, the servo's no-load speed, rad/s
    torque_Nm: float = np.inf  # stall torque, N m; infinite where the data sheet states none
    rms_torque_Nm: float = np.inf  # largest root mean square of the torque over the recording, N m
    period_s: float = PERIOD_S  # time between set-points, s
    resolution_rad: float = _FINEST_RAD  # set-points are multiples of it, rad
    rest_s: float = 1.0  # time at rest at either end, in which the noise is estimated, s
    largest_held_rad: float = np.inf  # beyond it the servo cannot hold its load, rad, if narrower

    @property
    def ticks(self) -> tuple[int, int]:
        """Smallest and largest set-point in units of the resolution."""
        low, high = np.array(self.position_rad) / self.resolution_rad
        return int(np.ceil(low - 1e-9)), int(np.floor(high + 1e-9))

    @property
    def most_ticks(self) -> int:
        """Largest change of the set-point in one period, in units of the resolution."""
        step = self.rate_rad_s * self.period_s / self.resolution_rad
        low, high = self.ticks
        return int(min(np.floor(step + 1e-9), high - low))

    @property
    def rest_rad(self) -> float:
        """Set-point at rest: the middle of the range, rad."""
        return round(sum(self.ticks) / 2) * self.resolution_rad

    @property
    def reach_rad(self) -> float:
        """Largest distance of a set-point from rest, rad."""
        low, high = np.array(self.ticks) * self.resolution_rad
        return float(max(high - self.rest_rad, self.rest_rad - low))

    def times(self, seconds: float) -> Array:
        """Times of the set-points, s, shape (T,)."""
        return np.asarray(np.arange(round(seconds / self.period_s)) * self.period_s)

    def within(self, commands: Array) -> Array:
        """Set-points changed as little as needed to keep the limits, shape (N, T)."""
        low, high = self.ticks
        rest, most, T = round((low + high) / 2), self.most_ticks, commands.shape[1]
        still = round(self.rest_s / self.period_s)
        # towards the end the range narrows so that rest is reached in time
        until_end = np.maximum(np.arange(T)[::-1] + 1 - still, 0) * most
        wanted: Integers = np.clip(np.round(commands / self.resolution_rad), low, high).astype(int)
        lowest, highest = np.maximum(low, rest - until_end), np.minimum(high, rest + until_end)
        wanted = np.clip(wanted, lowest, highest)
        wanted[:, :still] = rest
        limited = np.empty_like(wanted)
        limited[:, 0] = now = wanted[:, 0]
        for k in range(1, T):
            now = now + np.clip(wanted[:, k] - now, -most, most)
            limited[:, k] = now
        return np.asarray(limited * self.resolution_rad)


def limits_of(robot: Robot, joint: str | None = None) -> CommandLimits:
    """Limits of the commands of one joint, by default the first, from the robot's file."""
    described = _joint(robot, joint)
    servo, where = described.servo, described.where
    low, high = described.limits_rad
    step = servo.position_step_rad if servo.states("position_step_rad") else 0.0
    torque = servo.max_torque_Nm if servo.states("max_torque_Nm") else np.inf
    limits = CommandLimits(
        joint=described.name,
        position_rad=(low, high),
        rate_rad_s=servo.no_load_speed_rad_s,
        torque_Nm=torque,
        rms_torque_Nm=CONTINUOUS_SHARE * torque,
        resolution_rad=max(step, _FINEST_STEP_RAD) if step else _FINEST_RAD,
    )
    if limits.ticks[1] - limits.ticks[0] < 2:
        found = f"{low:g} to {high:g} rad, less than two steps of {limits.resolution_rad:g} rad"
        raise InputError(where[0], f"{where[1]}.limits_rad", found, "a wider range")
    if limits.most_ticks < 1:
        found = f"{servo.no_load_speed_rad_s:g} rad/s"
        least = limits.resolution_rad / limits.period_s
        expected = f"at least {least:.3g} rad/s, one step of {limits.resolution_rad:g} rad a sample"
        raise InputError(servo.where[0], f"{servo.where[1]}.no_load_speed_rad_s", found, expected)
    return limits


def check_seconds(seconds: float, limits: CommandLimits) -> None:
    """Raise an InputError unless a recording is long enough to move, and at most a day."""
    returning = limits.reach_rad / limits.rate_rad_s
    shortest = 2 * (limits.rest_s + returning) + 1.0
    if not shortest <= seconds <= 86_400:
        joint = limits.joint
        expected = f"{shortest:.1f} s for {joint} to move and come to rest, to a day"
        raise InputError("--seconds", "", f"{seconds:g} s", expected)


def holding(limits: CommandLimits, load: Load, robot: Robot) -> CommandLimits:
    """The limits, narrowed to angles where a pendulum's weight is within the torque budget."""
    if load.gravity_Nm <= limits.rms_torque_Nm:
        return limits
    most = float(np.arcsin(limits.rms_torque_Nm / load.gravity_Nm))
    low, high = limits.position_rad
    if -most <= low and high <= most:
        return limits
    ends = max(low, -most), min(high, most)
    narrowed = replace(limits, position_rad=ends, largest_held_rad=most)
    if narrowed.ticks[1] - narrowed.ticks[0] < 2:
        servo = _joint(robot, limits.joint).servo
        nearest = min(max(low, 0.0), high)
        found = f"{load.gravity_Nm * abs(np.sin(nearest)):.3g} N m or more to hold the load"
        expected = (
            f"less than {limits.rms_torque_Nm:.3g} N m in a part of the range: a lighter load, or "
            "a range about the angle at which it hangs"
        )
        raise InputError(servo.where[0], f"{servo.where[1]}.max_torque_Nm", found, expected)
    return narrowed


def _joint(robot: Robot, name: str | None) -> Joint:
    joint = robot.joints[0] if name is None else robot.joint(name)
    if joint is None:
        known = ", ".join(j.name for j in robot.joints)
        where = robot.path or robot.name
        raise InputError(where, "joints", f"no joint {name!r}", f"one of {known}")
    return joint


@dataclass(frozen=True)
class Context:
    """One way to set up the bench: what a user can change besides the commands."""

    name: str = "as it is"  # what the user calls it
    # loads by joint that replace those of the recordings so far
    loads: Mapping[str, Load] = field(default_factory=dict)
    supply: float = 1.0  # supply voltage, relative to that of the recordings so far
    gain: float = 1.0  # proportional gain of the firmware, relative to that of these recordings

    def load(self, rivals: JointRivals) -> Load:
        """Load of a joint in this context."""
        return self.loads.get(rivals.component, rivals.load)


AS_IT_IS = Context()
"""The bench of the recordings so far."""


def read_contexts(path: str | os.PathLike[str]) -> tuple[Context, ...]:
    """The contexts of a ``contexts.toml``; InputError if one is not valid."""
    top = Fields(path, "", read_toml(path))
    top.refuse_unknown(["contexts"])
    contexts: dict[str, Context] = {}
    for entry in top.tables("contexts"):
        entry.refuse_unknown(["name", "loads", "supply_ratio", "gain_ratio"])
        name, loads = entry.text("name"), entry.table("loads")
        by_joint = {joint: read_load(loads.table(joint)) for joint in loads.content}
        context = Context(
            name, by_joint, *(_ratio(entry, of) for of in ("supply_ratio", "gain_ratio"))
        )
        if context == Context(name):
            expected = "loads, supply_ratio or gain_ratio"
            raise InputError(path, entry.where, "a context that changes nothing", expected)
        if name in contexts:
            raise InputError(path, "contexts", f"two contexts named {name!r}", "one of each name")
        contexts[name] = context
    return tuple(contexts.values())


def _ratio(entry: Fields, name: str) -> float:
    value = entry.number(name, 1.0, above=0.0)
    if not 1e-3 <= value <= 1e3:
        raise entry.error(name, "a ratio from 0.001 to 1000")
    return value
