"""The recording that tells rival sets of effects apart, and what it is expected to tell.

Commands are scored by the entropy over the sets that a recording leaves.

Each set predicts y ~ N(m_i, I + U_i U_i'), whitened by the noise, with what its parameters, fitted
to the recordings so far, may still be (Box and Hill, Technometrics 9 (1967) 57-71). Two sets are as
far apart as the Bhattacharyya distance

    d_ij = r' S^-1 r / 8 + log(|S| / sqrt(|S_i| |S_j|)) / 2,   S = (S_i + S_j) / 2,  r = m_i - m_j;

with probabilities p the entropy that remains is at most sum_i p_i log(sum_j p_j exp(-d_ij) / p_i)
(Kolchinsky and Tracey, Entropy 19 (2017) 361, eq. 10). As the noise is fitted, the evidence of n
samples is at most n/2 log(1 + r'r / n) (Brockwell and Davis, Time Series, 1991, section 5.8), and a
diagnosis trusts a share of it (``effect_probabilities.trusted_share``).
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.special import entr, ndtr

from sim2real.arrays import Array
from sim2real.design.information import command_trace, rms_torque
from sim2real.design.limits import AS_IT_IS, Context, check_seconds, holding, limits_of
from sim2real.design.plan import NextRecording, commands_without_angles
from sim2real.design.search import best, part
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import SEPARATED, JointRivals, OpenSets, task
from sim2real.diagnose.screening import NUISANCES
from sim2real.errors import InputError
from sim2real.inference.correlated_noise import whitened
from sim2real.recording import PER_INERTIA
from sim2real.robot import Robot
from sim2real.servo.parameters import COLUMNS, FIRST_EFFECT_COLUMN
from sim2real.servo.rollout import Simulator, coarse_substep

_OPEN = 0.05
"""Probability from which a set of effects is one of several that remain."""
_LISTED = 6
"""Pairs of sets of a joint that are listed."""
_OWNERS = np.array([name.partition(".")[0] for name in COLUMNS])
"""Effect of each column of a row."""
_DIFFERENCE = 0.05
"""Step of differences, in standard deviations."""


class RivalObjective(ABC):
    """Scores commands by the entropy that they leave over M sets of effects."""

    def __init__(self, rivals: OpenSets, *, uniform: float = 0.0) -> None:
        """Give all sets the same ``uniform`` share of the probability."""
        self.rivals = rivals
        p = np.array([one.probability for one in rivals.sets])
        self.probability = (1 - uniform) * p / p.sum() + uniform / p.size

    @abstractmethod
    def excess(self, commands: Array) -> Array:
        """How much commands exceed limits of torque or place, relative or in m, (N,); 0 if kept."""

    @abstractmethod
    def predictions(self, commands: Array) -> Iterator[tuple[Array, Array, float]]:
        """For each command whitened predictions (M, n), spreads (M, F, n), and trusted share."""

    def __call__(self, commands: Array, *, penalty: float = 10.0) -> Array:
        """Scores of set-points in rad, (N, T) or (N, T, J), shape (N,); -inf where it diverges.

        Minus the entropy that remains, in nats, or that before the recording and a ``penalty`` per
        unit of what exceeds limits.
        """
        excess = self.excess(commands)
        scores = np.asarray(-entr(self.probability).sum() - penalty * excess)
        kept = excess == 0.0
        if kept.any():
            scores[kept] = -remaining_entropy(self.probability, self.distances(commands[kept]))
        return scores

    def distances(self, commands: Array) -> Array:
        """Bhattacharyya distances of all pairs of sets, shape (N, M, M); NaN where it diverges."""
        return np.array([x[2] * distances(*x[:2]) for x in self.predictions(commands)])


class JointObjective(RivalObjective):
    """What commands tell of the sets of effects that are open on one joint, in a context."""

    rivals: JointRivals

    def __init__(
        self, rivals: JointRivals, context: Context = AS_IT_IS, *, rms_torque_Nm: float = np.inf
    ) -> None:
        super().__init__(rivals)
        self.context, sets = context, rivals.sets
        self._rms = np.inf if context.load(rivals) is PER_INERTIA else rms_torque_Nm
        spreads = np.zeros((len(sets), max(one.columns.size for one in sets) + 1, len(COLUMNS)))
        for spread, one in zip(spreads, sets, strict=True):
            # every servo has a little of these waves of the angle
            alike = {effect.name for effect in NUISANCES} - set(one.effects)
            kept = ~np.isin(_OWNERS[one.columns], list(alike))
            root = _DIFFERENCE * root_of_inverse(one.information)[kept]
            spread[1 : 1 + root.shape[1], one.columns[kept]] = root.T
        theta = np.array([one.theta for one in sets])
        without = [np.where(np.isin(_OWNERS, one.effects), 0.0, one.theta) for one in sets]
        plain = sets[0].columns[sets[0].columns < FIRST_EFFECT_COLUMN]
        self._plain = plain.size
        moved = theta[0] * (1 + _DIFFERENCE * np.eye(len(COLUMNS))[plain])
        self._rows = np.vstack([*(theta[:, None] + spreads), without, moved])
        self._gain = np.array([one.gain for one in sets])

    def excess(self, commands: Array) -> Array:
        """Torque of the most probable set beyond the largest, relative to it, shape (N,)."""
        if not np.isfinite(self._rms):
            return np.zeros(len(commands))
        angles = np.concatenate(self._angles(commands, self._rows[:1]))
        torque = rms_torque(self.context.load(self.rivals), angles, self.rivals.period_s)
        return np.nan_to_num(np.maximum(torque / self._rms - 1, 0.0), nan=np.inf)

    def predictions(self, commands: Array) -> Iterator[tuple[Array, Array, float]]:
        """For each command whitened predictions (M, n), spreads (M, F, n), and trusted share."""
        M, noise = self.probability.size, self.rivals.autoregression
        for angles in self._angles(commands, self._rows):
            signals = whitened(angles / self.rivals.noise_rad, noise)[:, noise.size :]
            cuts = [-M - self._plain, len(signals) - self._plain]
            of_sets, without, moved = np.split(signals, cuts)
            of_sets = of_sets.reshape(M, -1, signals.shape[1])
            mean = of_sets[:, 0]
            plain = (moved - mean[0]) / _DIFFERENCE
            spread = (of_sets[:, 1:] - mean[:, None]) / _DIFFERENCE
            yield mean, spread, self.trusted(mean - without, plain)

    def trusted(self, effect: Array, plain: Array) -> float:
        """Share of the evidence that a diagnosis trusts, by the gain of each set.

        A refit of the plain servo, with derivatives ``plain`` (B, n) by the logarithms of its
        parameters, takes up a part of the ``effect`` that sets have on the signals, (M, n).
        """
        across = effect @ plain.T
        taken = np.linalg.solve(np.eye(len(plain)) + plain @ plain.T, across.T).T
        left = np.sum(effect**2, axis=1) - np.sum(across * taken, axis=1)
        energy = self._gain + _fitted_noise(left, effect.shape[1]) / 2
        return float(1 / (1 + DECISION.law_error**2 * energy) @ self.probability)

    def _angles(self, commands: Array, rows: Array) -> list[Array]:
        """Angles of servos (B, P) for each command (N, T), in rad, one array (B, T) each."""
        plan = command_trace(self.context.load(self.rivals), commands[0], self.rivals.period_s)
        plan = replace(plan, supply_ratio=self.context.supply, gain_ratio=self.context.gain)
        simulator = Simulator([replace(plan, command=command) for command in commands])
        # one sub-step, so that differences of rows are smooth
        return simulator.angles(rows, coarse_substep(simulator.substeps(self._rows)).min())


def root_of_inverse(precision: Array) -> Array:
    """A matrix R with R R' = the inverse of a precision (F, F)."""
    scale = 1 / np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(precision * np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector / np.sqrt(np.maximum(value, 1e-10)))


def distances(mean: Array, spread: Array) -> Array:
    """Bhattacharyya distances of M sets, (M, M), by predictions (M, n) and spreads (M, F, n).

    All are NaN where a simulation diverged.
    """
    M, F, n = spread.shape
    columns = np.concatenate([mean - mean[0], spread.reshape(-1, n)])
    if not (np.abs(columns) < 1e7).all():
        return np.full((M, M), np.nan)
    products, of_set = columns @ columns.T, M + np.arange(M * F).reshape(M, F)
    i, j = np.triu_indices(M, 1)
    both = np.concatenate([of_set[i], of_set[j]], axis=1)
    across = products[both, i[:, None]] - products[both, j[:, None]]
    inner = np.eye(2 * F) + products[both[:, :, None], both[:, None, :]] / 2
    taken = np.einsum("pf,pf->p", across, np.linalg.solve(inner, across[..., None])[..., 0]) / 2
    square = products[i, i] - 2 * products[i, j] + products[j, j] - taken
    alone = np.linalg.slogdet(np.eye(F) + products[of_set[:, :, None], of_set[:, None, :]])[1]
    volume = np.linalg.slogdet(inner)[1] - (alone[i] + alone[j]) / 2
    out = np.zeros((M, M))
    out[i, j] = np.maximum(_fitted_noise(square, n) / 8 + volume / 2, 0.0)
    return np.asarray(out + out.T)


def _fitted_noise(square: Array, count: int) -> Array:
    """Twice the log-likelihood ratio, where the noise is fitted to what a set leaves, (P,)."""
    return np.asarray(count * np.log1p(np.maximum(square, 0.0) / max(count, 1)))


def remaining_entropy(probability: Array, distances: Array) -> Array:
    """Upper bound in nats, (N,), of the entropy over M sets, from (M,) and distances (N, M, M)."""
    with np.errstate(invalid="ignore"):
        overlap = np.exp(-distances) @ probability
        bound = np.log(overlap / probability) @ probability
    return np.where(np.isfinite(bound), bound, np.inf)


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
        {one.component: context.load(one) for one in rivals},
        kind="servo",
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
    before, bound = float(entr(p).sum()), float(remaining_entropy(p, distances)[0])
    remaining = before - achieved * (before - bound)
    return JointForecast(objective.rivals, before, remaining, command, pairs)
