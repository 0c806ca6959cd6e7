"""The recording that tells the rival sets of a diagnosis apart, and what it is expected to tell."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import combinations
from itertools import count as counter
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr

from sim2real.arrays import Array
from sim2real.design.contexts import AS_IT_IS, Context
from sim2real.design.limits import check_seconds, holding, limits_of
from sim2real.design.plan import next_recording
from sim2real.design.rivals import RivalObjective, remaining_entropy
from sim2real.design.search import SearchResult, best
from sim2real.diagnose.rival_sets import SEPARATED, JointRivals, OpenSets, entropy, task
from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
class RivalDesign(NotebookDisplay):
    """A recording to make next."""

    context: Context  # what to change besides the commands
    joints: tuple[JointForecast, ...]  # what it is expected to tell, joint by joint
    least: float = _OPEN  # probability from which a set counts as open
    # as returned by ``sim2real.output.provenance``
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def t(self) -> Array:
        """Times of the set-points in s, shape (T,)."""
        first = self.joints[0]
        return np.asarray(first.rivals.period_s * np.arange(len(first.command), dtype=np.float64))

    def recording(self, name: str = "next") -> Recording:
        """The commands as a recording without measured angles, and what they are to tell."""
        rivals = [joint.rivals for joint in self.joints if isinstance(joint.rivals, JointRivals)]
        loads = {one.component: self.context.load(one) for one in rivals}
        commands = [joint.command for joint in self.joints]
        context = {"name": self.context.name, **self.context.ratios}
        return next_recording(name, self.t, commands, loads, self.statement | {"context": context})

    @property
    def statement(self) -> dict[str, Any]:
        """What the recording is to tell, as its JSON states it."""
        return {
            "rivals": [joint.content() for joint in self.joints],
            "provenance": dict(self.provenance),
        }

    def plot(self, joint: str | None = None) -> Figure:
        """Commands of one joint."""
        by_name = {one.rivals.component: one for one in self.joints}
        chosen = self.joints[0] if joint is None else by_name[joint]
        figure: Figure = from_report("design_plot.rivals_figure")(chosen)
        return figure

    @property
    def setting(self) -> str:
        """What the recording needs besides its commands, in one line."""
        return f"context: {self.context.name}"

    @property
    def informative(self) -> bool:
        """Whether some pair of open sets is expected to be distinguished."""
        return self._best()[1].expected >= SEPARATED

    def _best(self) -> tuple[str, ExpectedSeparation]:
        """The pair of open sets that is told apart best, and its component."""
        pairs = []
        for joint in self.joints:
            open_sets = {x.effects for x in joint.rivals.sets if x.probability >= self.least}
            pairs += [
                (joint.rivals.component, pair)
                for pair in joint.pairs
                if open_sets.issuperset((pair.first, pair.second))
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
    change_gain: float = 0.02,
) -> RivalDesign:
    """The commands, and the context, that leave the least expected entropy over the rival sets.

    Random commands are scored in every context besides the bench as it is; the best are varied in
    the best context. All joints move at once. Of the ``samples`` set-points that are simulated for
    a joint, a third are for random commands. A change of context must save ``change_gain`` nats.
    """
    rivals = [one for one in rivals if request.leaves_open(one)]
    if not rivals:
        none = "no joint with several probable sets of effects"
        raise InputError(request.file, "rival_sets", none, "a diagnosis that leaves some open")
    _check_joints(rivals, contexts, robot, request.file)
    seconds, offered, limits = request.seconds, [AS_IT_IS, *contexts], {}
    for one in rivals:
        own = replace(limits_of(robot, one.component), period_s=one.period_s)
        check_seconds(seconds, own)
        for context in contexts:
            if one.component in context.loads:
                own = holding(own, context.loads[one.component], robot)
        limits[one.component] = own
    count = max(own.times(seconds).size for own in limits.values())
    commands = int(np.clip(samples / count, 64, 800))
    few = max(commands // 3 // len(offered), 16)
    stages, done = len(rivals) * (len(offered) + 1), counter()

    def found(one: JointRivals, context: Context, **options: Any) -> tuple[Any, SearchResult]:  # noqa: ANN401
        """The objective and the best commands of a joint; two commands' parts are exchanged."""
        k, own = next(done), limits[one.component]
        # the same random commands in every context
        rng = np.random.default_rng([request.seed, list(limits).index(one.component)])
        objective = RivalObjective(one, context, rms_torque_Nm=own.rms_torque_Nm)
        # eight assemblies took 37 s and two 16 s on the bench that was measured, for the same
        return objective, best(
            objective, own, seconds, rng=rng, drawn=few, assemblies=2,
            progress=lambda share: request.progress((k + share) / stages), **options,
        )  # fmt: skip

    looks = [
        [found(one, context, rounds=0, batch=min(few, 32))[1] for one in rivals]
        for context in offered
    ]
    scores = np.array([sum(joint.score for joint in joints) for joints in looks])
    scores[1:] -= change_gain
    k = int(scores.argmax())
    joints = []
    for one, first in zip(rivals, looks[k], strict=True):
        start = first.command[None]
        objective, last = found(one, offered[k], rounds=commands // 2 // 32, start=start)
        joints.append(forecast(objective, last.command))
    return RivalDesign(offered[k], tuple(joints), request.least)


def _check_joints(
    rivals: Sequence[JointRivals],
    contexts: Sequence[Context],
    robot: Robot,
    file: str | os.PathLike[str],
) -> None:
    """Check that the robot has the joints of a diagnosis and of contexts, whose loads are known."""
    known = ", ".join(joint.name for joint in robot.joints)
    of_contexts = {name: "contexts" for context in contexts for name in context.loads}
    for name, where in ({one.component: file for one in rivals} | of_contexts).items():
        if robot.joint(name) is None:
            raise InputError(where, "", f"joint {name!r}", f"a joint of {robot.name}: {known}")
    for one in rivals:
        if one.load is PER_INERTIA and one.component in of_contexts:
            found = "a load where the recordings so far state none"
            raise InputError("contexts", f"loads.{one.component}", found, "one in all or in none")


def forecast(
    objective: Any,  # noqa: ANN401 - of servos or of a swim
    command: Array,
    *,
    achieved: float = 0.4,
) -> JointForecast:
    """What a command (T,), or (T, J) of the body, is expected to tell of a joint or of the body.

    ``objective`` has the sets (``rivals``), their ``probability`` (M,), and the Bhattacharyya
    ``distances`` (N, M, M) that commands put between them. ``achieved`` is the share of the
    computed reduction of entropy that is expected of a recording: the computation assumes that one
    of the sets is the full truth. That of servos is from a regression over 65 development benches
    (``reports/design/rivals.md``).
    """
    p, distances = objective.probability, objective.distances(command[None])
    sets = [one.effects for one in objective.rivals.sets]
    places = list(combinations(range(len(sets)), 2))
    places.sort(key=lambda pair: -p[pair[0]] * p[pair[1]])
    apart = [(i, j, float(distances[0, i, j])) for i, j in places]
    pairs = tuple(
        ExpectedSeparation(sets[i], sets[j], distance, float(ndtr(np.sqrt(2 * distance))))
        for i, j, distance in apart
    )
    before, bound = entropy(p), float(remaining_entropy(p, distances)[0])
    remaining = before - achieved * (before - bound)
    return JointForecast(objective.rivals, before, remaining, command, pairs)
