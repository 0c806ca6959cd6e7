"""The recording that tells the rival sets of a diagnosis apart, and what it is expected to tell."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.special import ndtr

from sim2real.arrays import Array
from sim2real.design.limits import AS_IT_IS, Context, check_seconds, holding, limits_of
from sim2real.design.plan import NextRecording, commands_without_angles
from sim2real.design.rivals import JointObjective, RivalObjective, remaining_entropy
from sim2real.design.search import best, part
from sim2real.diagnose.rival_sets import SEPARATED, JointRivals, OpenSets, entropy, task
from sim2real.errors import InputError
from sim2real.recording import PER_INERTIA
from sim2real.robot import Robot

_OPEN = 0.05
"""Probability from which a set of effects is one of several that remain."""
_LISTED = 6
"""Pairs of sets of a joint that are listed."""


@dataclass(frozen=True)
class Request:
    """What is asked of a recording that tells rival sets apart."""

    seconds: float = 30.0  # its duration
    # whether to go on where one set of effects is left: then the commands are to show effects that
    # the recordings so far would have left hidden
    again: bool = False
    seed: int = 0  # of the search
    file: str | os.PathLike[str] = "diagnosis"  # that the sets come from, for messages
    progress: Callable[[float], None] = lambda share: None  # called with the share that is done

    @property
    def least(self) -> float:
        """Probability from which a set counts as open."""
        return 0.0 if self.again else _OPEN

    def leaves_open(self, rivals: OpenSets) -> bool:
        """Whether several sets count as open."""
        return sum(one.probability >= self.least for one in rivals.sets) > 1


@dataclass(frozen=True)
class ExpectedSeparation:
    """Two rival sets of effects, and how surely the recording is expected to tell them apart."""

    first: tuple[str, ...]  # effects of the more probable set
    second: tuple[str, ...]  # effects of the other
    distance: float  # Bhattacharyya distance of their predictions
    expected: float
    """Probability that the evidence will favour the true one of both, Phi(sqrt(2 distance)) for
    predictions of equal covariance."""

    def __str__(self) -> str:
        """How the sets differ, and the expected probability of distinguishing them."""
        return f"{task(self.first, self.second)} with {self.expected:.2f}"


@dataclass(frozen=True)
class JointForecast:
    """What the recording is expected to tell of one joint, or of the body."""

    rivals: OpenSets  # the sets of effects that were open
    entropy: float  # entropy over the sets before, nats
    remaining: float  # entropy that is expected to remain, nats
    command: Array  # the set-points, rad, shape (T,), or (T, J) of all joints for the body
    pairs: tuple[ExpectedSeparation, ...]  # all pairs of sets, those that matter most first

    @property
    def times(self) -> Array:
        """Times of the set-points in s, shape (T,)."""
        return np.asarray(self.rivals.period_s * np.arange(len(self.command), dtype=np.float64))

    def content(self) -> dict[str, Any]:
        """An entry of ``rivals`` in the recording's JSON."""
        return {
            "component": self.rivals.component,
            "entropy_before_nats": self.entropy,
            "entropy_after_nats": self.remaining,
            "sets": [one.content() for one in self.rivals.sets],
            "pairs": [asdict(pair) for pair in self.pairs],
        }


@dataclass(frozen=True)
class RivalDesign(NextRecording):
    """Commands that tell the sets of effects apart that a diagnosis left open."""

    joints: tuple[JointForecast, ...]  # what it is expected to tell, joint by joint
    setting: str  # what the recording needs besides its commands, in one line
    least: float = _OPEN  # probability from which a set counts as open

    @property
    def informative(self) -> bool:
        """Whether some pair of open sets is expected to be distinguished."""
        return self._best()[1].expected >= SEPARATED

    def _best(self) -> tuple[str, ExpectedSeparation]:
        """The pair of open sets that is told apart best, and its component."""
        pairs = [
            (joint.rivals.component, pair)
            for joint in self.joints
            for still in [{x.effects for x in joint.rivals.sets if x.probability >= self.least}]
            for pair in joint.pairs
            if still.issuperset((pair.first, pair.second))
        ]
        return max(pairs, key=lambda pair: pair[1].expected)

    def __str__(self) -> str:
        """What is expected, one line a joint and one a pair."""
        if not self.informative:
            component, best = self._best()
            return (
                "Nothing more can be distinguished within these limits: no command that was tried "
                f"separates two sets with {SEPARATED:g}. The best: {component}: {best}."
            )
        lines = [self.setting]
        for joint in self.joints:
            component, before = joint.rivals.component, np.exp(joint.entropy)
            lines.append(
                f"{component}: {before:.1f} equally probable sets of effects are expected to "
                f"become {np.exp(joint.remaining):.1f}"
            )
            lines += [f"  {component}: {pair}" for pair in joint.pairs[:_LISTED]]
        return "\n".join(lines)


def design_for_rivals(
    rivals: Sequence[JointRivals],
    robot: Robot,
    request: Request,
    contexts: Sequence[Context] = (),
    *,
    samples: float = 6e5,
) -> RivalDesign:
    """The commands, and the context, that leave the least expected entropy over the rival sets.

    All joints move at once, in the context whose best commands tell most. ``samples`` set-points
    are simulated for a joint, a third of them of random commands.
    """
    rivals = [one for one in rivals if request.leaves_open(one)]
    if not rivals:
        none = "no joint with several probable sets of effects"
        raise InputError(request.file, "rival_sets", none, "a diagnosis that leaves some open")
    of_contexts = {name: "contexts" for context in contexts for name in context.loads}
    for name, where in ({one.component: request.file for one in rivals} | of_contexts).items():
        if robot.joint(name) is None:
            known = ", ".join(joint.name for joint in robot.joints)
            raise InputError(where, "", f"joint {name!r}", f"a joint of {robot.name}: {known}")
    seconds, offered, limits = request.seconds, [AS_IT_IS, *contexts], []
    for one in rivals:
        if one.load is PER_INERTIA and one.component in of_contexts:
            found = "a load where the recordings so far state none"
            raise InputError("contexts", f"loads.{one.component}", found, "one in all or in none")
        own = replace(limits_of(robot, one.component), period_s=one.period_s)
        check_seconds(seconds, own)
        for context in contexts:
            own = holding(own, context.loads.get(one.component, PER_INERTIA), robot)
        limits.append(own)
    count = max(own.times(seconds).size for own in limits)
    commands = int(np.clip(samples / count, 64, 800) / len(offered))
    plans: list[tuple[float, Context, list[JointForecast]]] = []
    for context in offered:
        score, joints = 0.02 * (context is AS_IT_IS), []  # nats that another one must save
        for k, (one, own) in enumerate(zip(rivals, limits, strict=True)):
            objective = JointObjective(one, context, rms_torque_Nm=own.rms_torque_Nm)
            result = best(
                objective, own, seconds,
                rng=np.random.default_rng([request.seed, k]),  # the same in every context
                drawn=max(commands // 3, 16), rounds=commands // 12,
                progress=part(
                    request.progress, len(plans) * len(rivals) + k, len(rivals) * len(offered)
                ),
            )  # fmt: skip
            score += result.score
            joints.append(forecast(objective, result.command))
        plans.append((score, context, joints))
    _, context, chosen = max(plans, key=lambda plan: plan[0])
    loads = {one.component: context.load(one) for one in rivals}
    recording = commands_without_angles(
        chosen[0].times,
        {joint.rivals.component: joint.command for joint in chosen},
        {
            "rivals": [joint.content() for joint in chosen],
            "context": {
                "name": context.name,
                "supply_ratio": context.supply,
                "gain_ratio": context.gain,
            },
        },
        kind="servo",
        loads={name: load for name, load in loads.items() if load is not PER_INERTIA},
    )
    return RivalDesign(recording, tuple(chosen), f"context: {context.name}", request.least)


def forecast(objective: RivalObjective, command: Array, *, achieved: float = 0.4) -> JointForecast:
    """What a command (T,), or (T, J) of the body, is expected to tell of a joint or of the body.

    ``achieved`` is the share of the computed reduction of entropy that is expected of a recording:
    the computation assumes that one of the sets is the full truth. That of servos is from a
    regression over 65 development benches (``reports/design/rivals.md``).
    """
    p, distances = objective.probability, objective.distances(command[None])
    sets = [one.effects for one in objective.rivals.sets]
    places = sorted(combinations(range(p.size), 2), key=lambda pair: -p[pair[0]] * p[pair[1]])
    pairs = tuple(
        ExpectedSeparation(sets[i], sets[j], d, float(ndtr(np.sqrt(2 * d))))
        for i, j in places
        for d in [float(distances[0, i, j])]
    )
    before, bound = entropy(p), float(remaining_entropy(p, distances)[0])
    remaining = before - achieved * (before - bound)
    return JointForecast(objective.rivals, before, remaining, command, pairs)
