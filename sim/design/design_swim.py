"""The swim that tells the rival sets of a diagnosis of swims apart, and what it is to tell."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sim.design.swim_commands import SwimLimits, draw, usual
from sim.design.swim_objective import SwimObjective
from sim2real.design.contexts import AS_IT_IS
from sim2real.design.limits import check_seconds, limits_of
from sim2real.design.search import best
from sim2real.design.tell_apart import Request, RivalDesign, forecast
from sim2real.diagnose.swim_rivals import SwimRivals
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.robot import Robot


@dataclass(frozen=True)
class SwimDesign(RivalDesign):
    """A swim to make next, from standstill in the middle of the pool, heading along x.

    Attributes:
        moved_joints: The joints that ``command`` of the forecast moves, in its order.
    """

    moved_joints: tuple[str, ...] = field(default=())

    @property
    def setting(self) -> str:
        """Where the swim starts, in one line."""
        return "start: at rest in the middle of the pool, heading along x"

    def recording(self, name: str = "next") -> Recording:
        """The commands as a recording without measurements, and what they are to tell."""
        (body,) = self.joints
        return Recording(
            name=name,
            kind="pool",
            joints=self.moved_joints,
            t=self.t,
            command=body.command,
            position=np.full(body.command.shape, np.nan),
            medium="water",
            source="Commands to swim next, by 'sim2real design'.",
            metadata=self.statement,
        )


def design_swim(
    rivals: SwimRivals,
    model: Model,
    robot: Robot,
    request: Request,
    *,
    drawn: int = 96,
    rounds: int = 4,
    threads: int = 2,
) -> SwimDesign:
    """The commands of a swim that leave the least expected entropy over the rival sets.

    Random swims, and those of ``swim_commands.usual``, are simulated in the twin with each set; the
    best are varied.

    Args:
        rivals: The sets that are open.
        model: The model of the diagnosis: servos, and the twin's law and error.
        robot: The robot, for the limits of its commands.
        request: Duration, seed, and which sets count.
        drawn: Number of random swims.
        rounds: Number of batches of 16 variations of the best.
        threads: CPU threads.

    Raises:
        InputError: If fewer than two sets are probable, the robot is another one, the duration is
            too short, or no swim that was tried keeps within the limits.
    """
    seconds, file = request.seconds, request.file
    if not request.leaves_open(rivals):
        none = "fewer than two probable sets of effects"
        raise InputError(file, "swim_rivals", none, "a diagnosis that leaves some open")
    if rivals.joint_sd_rad.size != len(robot.joints):
        found = f"a diagnosis of {rivals.joint_sd_rad.size} joints"
        raise InputError(file, "swim_rivals", found, f"the {len(robot.joints)} of {robot.name}")
    limits = SwimLimits(
        tuple(
            replace(limits_of(robot, joint.name), period_s=rivals.period_s)
            for joint in robot.joints
        )
    )
    for joint in limits.joints:
        check_seconds(seconds, joint)
    objective = SwimObjective(rivals, model, robot, limits, threads=threads, file=file)
    result = best(
        objective, limits, seconds, rng=np.random.default_rng(request.seed), draw=draw, drawn=drawn,
        rounds=rounds, batch=16, start=usual(limits, seconds), progress=request.progress,
    )  # fmt: skip
    for limit, excess in objective.excesses(result.command[None]).items():
        if excess[0] > 0:
            found = f"swims that exceed the {limit}, of {result.evaluated} tried"
            raise InputError(robot.path or robot.name, "limits", found, "a shorter swim")
    names = tuple(joint.joint for joint in limits.joints)
    body = forecast(objective, result.command, achieved=1.0)  # not measured for swims
    return SwimDesign(AS_IT_IS, (body,), request.least, moved_joints=names)
