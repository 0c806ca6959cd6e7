"""The design of the next recording: commands of every joint and what they are expected to tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.design.belief import Belief, belief_of
from sim2real.design.information import Information, Precision
from sim2real.design.limits import CommandLimits, check_seconds, limits_of
from sim2real.design.search import Found, best
from sim2real.model import Model
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot


@dataclass(frozen=True)
class JointDesign:
    """The commands of one joint and what is expected of them.

    Attributes:
        limits: Limits of the commands.
        belief: What was believed of the servo.
        found: The result of the search.
        precision: Expected precision of the parameters, of one command (N = 1).
    """

    limits: CommandLimits
    belief: Belief
    found: Found
    precision: Precision

    @property
    def expected(self) -> dict[str, float]:
        """Expected relative half-width of the 90 % interval of each parameter."""
        mean = np.exp(np.log(self.precision.half_width[0]).mean(axis=0))
        return dict(zip(self.belief.names, (float(x) for x in mean), strict=True))


@dataclass(frozen=True)
class Design:
    """Commands to record next.

    Attributes:
        t: Times in s, shape (T,).
        joints: The design of each joint.
    """

    t: Array
    joints: Mapping[str, JointDesign]

    def recording(self, name: str = "next") -> Recording:
        """The commands as a recording without measured angles."""
        names = tuple(self.joints)
        command = np.stack([joint.found.command for joint in self.joints.values()], axis=1)
        loads = {
            joint: design.belief.load
            for joint, design in self.joints.items()
            if design.belief.load is not PER_INERTIA
        }
        return Recording(
            name=name,
            kind="servo",
            joints=names,
            t=self.t,
            command=command,
            position=np.full(command.shape, np.nan),
            loads=loads,
            source="Commands to record next, by 'sim2real design'.",
        )


def design(
    robot: Robot,
    model: Model | None,
    *,
    seconds: float = 30.0,
    loads: Mapping[str, Load] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> Design:
    """Commands that determine the servos best, within the limits of the robot.

    Args:
        robot: The robot.
        model: Its fitted servos; None for what the data sheets say.
        seconds: Duration of the recording, s.
        loads: Load of each joint; by default that of the model.
        seed: Seed of the search.
        progress: Called with the share that is done.

    Raises:
        InputError: If limits contradict each other, or the duration is too short.
    """
    names = [j.name for j in robot.joints if model is None or j.name in model.joints]
    limits = {name: limits_of(robot, model, name) for name in names}
    for joint in limits.values():
        check_seconds(seconds, joint)
    designs = {}
    for k, (name, joint) in enumerate(limits.items()):
        belief = belief_of(robot, model, joint, load=(loads or {}).get(name), seed=seed)
        information = Information(belief, joint)

        def report(share: float, done: int = k) -> None:
            progress((done + share) / len(names))

        rng = np.random.default_rng([seed, k])
        found = best(information, joint, seconds, rng=rng, progress=report)
        precision = information.precision(found.command[None])
        designs[name] = JointDesign(joint, belief, found, precision)
    return Design(next(iter(limits.values())).times(seconds), designs)
