"""Search for the effects that are missing in swims, before probabilities are computed.

The search is ``sim2real.inference.selection`` on the problem of ``twin_search``: every effect of
the catalogue is fitted together with servos and force law, and the error of the twin counts as
noise. An effect is reported if it predicts the end of each swim better when fitted to the
beginning. Effects that imitate one another form a group. Where an unnamed shape (``unlisted``) fits
better than all effects, the diagnosis abstains. Thresholds are in ``law_error.json``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from sim.calibration.swim_parameters import Candidate
from sim.inference import poses
from sim.inference.coordinates import Coordinates, SwimSimulator, signals_of
from sim.inference.discrepancy import SHARE
from sim.inference.law_error import LAW_ERROR, NEVER, LawError
from sim.inference.linear_fit import together
from sim.inference.swims import Swim
from sim.inference.twin_search import Fit, SwimPrior, TwinSwims
from sim.inference.unlisted import gains
from sim2real.arrays import Array
from sim2real.body import listed, values
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, Members, select
from sim2real.model import Model
from sim2real.progress import Progress
from sim2real.robot import Robot

MOST = 2
"""Largest number of effects of a set, lost frames not counted."""
COST = 3.422
"""Log-evidence that an effect must gain in the search; probabilities are computed later."""
HELD_OUT = 0.3
"""Share of each swim, at its end, on which predictions are compared."""
_ERROR_LIMITS = (0.5, 6.0)
"""Limits of the mean square error of the twin for one robot, relative to the usual one."""
_SCALES = (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)
"""Scales of the variation between swims of a robot that are compared."""
_ROUNDS = 1
"""Times that the common part of the error is estimated again, linearised anew."""
_RIVALS = 4
_DOUBTFUL = 3.0
"""Log-evidence above which an error of a strong effect counts as noise."""
_CLOSE = 10.0
"""Log-evidence within which a rival is fitted to convergence, as the best set is."""


@dataclass(frozen=True)
class TriedSet:
    """Result of one set of effects, as decisions use it.

    Attributes:
        names: Effects as ``(name, component)``.
        evidence: Log-evidence relative to that without effects, before any cost.
        settled: Whether its fit converged.
    """

    names: tuple[tuple[str, str], ...]
    evidence: float
    settled: bool


class HeldOutErrors(NamedTuple):
    """Errors on the end of the swims of a fit to their beginning.

    Attributes:
        fit: The fit to the beginning.
        loss: Loss on the end.
        speed: Error of the speed over ground on the end, m/s.
    """

    fit: Fit
    loss: float
    speed: float


@dataclass(frozen=True)
class Searched:
    """Result of a search, before decisions.

    Attributes:
        problem: The swims.
        plain: The fit without effects.
        found: Every set that was tried, best first.
        best: The best set with an effect, likely or not.
        nameless: Evidence that unnamed shapes add to the plain fit and to the best.
        held: Held-out errors of each set.
        misfit: Mean square of the best fit's weighted errors by signal and band, shape (4, 3).
    """

    problem: TwinSwims
    plain: Hypothesis[Fit]
    found: list[Hypothesis[Fit]]
    best: Hypothesis[Fit]
    nameless: dict[str, dict[str, float]]
    held: dict[Members, HeldOutErrors]
    misfit: Array

    def table(self) -> list[TriedSet]:
        """The results of all sets."""
        zero = self.plain.evidence
        return [
            TriedSet(names_of(hypothesis.members), hypothesis.evidence - zero, hypothesis.fit.local)
            for hypothesis in self.found
        ]


def names_of(members: Members) -> tuple[tuple[str, str], ...]:
    """Names and components of the effects of a set, sorted."""
    effects: list[Candidate] = list(members)
    return tuple(sorted((effect.name, effect.component) for effect in effects))


def learned(
    references: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    law_error: LawError = LAW_ERROR,
) -> SwimPrior:
    """Prior of a robot's swims, learned from reference swims in which nothing is missing.

    Without reference swims it is the prior of all robots, with a larger error of the twin.
    """
    coordinates = Coordinates.of(robot, model)
    mean, covariance = law_error.prior(coordinates)
    imitation = law_error.imitation(coordinates)
    usual = SwimPrior(mean, covariance, imitation, law_error.shares)
    if not references:
        return replace(usual, shares=law_error.decisions["unreferred"] * law_error.shares)
    problem = TwinSwims(coordinates, references, simulate, usual)
    plain = problem.plain()
    relative_error = np.sqrt(np.clip(_misfit(problem, plain), *_ERROR_LIMITS))
    common, spread, scale = _common(problem, plain.fit, usual)
    for _ in range(_ROUNDS):
        problem = TwinSwims(coordinates, references, simulate, replace(usual, mean=common))
        common, spread, scale = _common(problem, problem.at(problem.centre(frozenset())), usual)
    imitation = scale * imitation
    return SwimPrior(
        common, spread + np.diag(imitation**2), imitation, law_error.shares * relative_error
    )


def _common(problem: TwinSwims, fit: Fit, usual: SwimPrior) -> tuple[Array, Array, float]:
    """Parameters common to the swims of a robot (F,), their covariance, and the scale of the rest.

    A linear mixed model about a fit (Laird and Ware, Biometrics 38 (1982) 963): the parameters of
    each swim are distributed about those of the robot. The scale of their distribution, relative
    to the usual one, is the likeliest of ``_SCALES``.
    """
    variance = np.square(usual.imitation)
    common = usual.covariance - np.diag(variance)
    least = np.square(NEVER * np.array([c.step for c in problem.coordinates.columns]))
    precision = np.linalg.inv(common + np.diag(np.maximum(least - np.diag(common), 0.0)))
    point = fit.x + problem.coordinates.seems
    parts, row = [], 0
    for weight in problem.weights:
        part = fit.near.slope[row : row + weight.size]
        parts.append((part.T @ part, part.T @ fit.rows[row : row + weight.size]))
        row += weight.size
    largest = -np.inf
    estimate: tuple[Array, Array, float] = (point, common, 1.0)
    for scale in _SCALES:
        curvature, slope, inner = together(parts, scale**2 * variance)
        curvature, gradient = curvature + precision, precision @ (usual.mean - point) - slope
        evidence = 0.0
        for (_, swim_gradient), of_swim in zip(parts, inner, strict=True):
            size = np.log(scale**2 * variance).sum() - np.linalg.slogdet(of_swim)[1]
            evidence += 0.5 * float(swim_gradient @ of_swim @ swim_gradient) - 0.5 * float(size)
        posterior: Array = np.asarray(np.linalg.inv(curvature), dtype=np.float64)
        evidence += 0.5 * float(gradient @ posterior @ gradient) - 0.5 * float(
            np.linalg.slogdet(curvature)[1]
        )
        if evidence > largest:
            largest, estimate = evidence, (point + posterior @ gradient, posterior, scale)
    return estimate


def searched(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    prior: SwimPrior,
    progress: Progress = lambda share: None,
    simulated: Model | None = None,
) -> Searched:
    """Try sets of effects on swims of one robot.

    The twin predicts a strong effect with an error in proportion to the change that the effect
    makes. Where the fluid was simulated and the best set changes much, a second search counts this
    error as noise. It is not used with the twin alone, where it has not been graded.

    Args:
        swims: The recordings.
        model: The servos, and the twin's law where the fluid was simulated.
        robot: The robot.
        simulate: The twin, alone or corrected by the fluid.
        prior: Prior of servos, force law and effects, see ``learned``.
        progress: Called with the share that is done.
        simulated: Model that the fluid simulated; its effects have no such error.
    """
    problem = TwinSwims(Coordinates.of(robot, model), swims, simulate, prior)
    tried, order, best = _search(problem, lambda share: progress(0.5 * share))
    if "water" in model.body:
        doubted = changed(problem, best.fit.x, simulated)
        parts = zip(doubted, problem.blocks, problem.weights, strict=True)
        size = sum(float(np.sum(b.about(change) * w**2)) for change, b, w in parts)
        if 0.5 * SHARE**2 * size > _DOUBTFUL:
            problem = TwinSwims(Coordinates.of(robot, model), swims, simulate, prior,
                                doubted=doubted)  # fmt: skip
            tried, order, best = _search(problem, lambda share: progress(0.5 + 0.4 * share))
    plain = tried[frozenset()]
    held = {}
    for members in _subsets(best.members):
        if members in tried:
            held[members] = _held_out(problem, tried[members])
    nameless = {"plain": gains(problem, plain.members, plain.fit)}
    nameless["best"] = gains(problem, best.members, best.fit)
    progress(1.0)
    return Searched(problem, plain, order, best, nameless, held, _misfit(problem, best))


def _search(
    problem: TwinSwims, progress: Progress
) -> tuple[dict[Members, Hypothesis[Fit]], list[Hypothesis[Fit]], Hypothesis[Fit]]:
    """Every set that was tried by its members, sorted by evidence, and the best with an effect."""
    plain = problem.plain()
    progress(0.1)
    ledger: Ledger[Fit] = Ledger(0)
    ledger.keep(plain)
    most = MOST + any(problem.counted(frozenset({e})) > 0 for e in problem.coordinates.effects)
    breadth = Breadth(most=most, added=5, rivals=3, within=np.inf)
    problem.cost = COST
    select(problem, [ledger], breadth, lambda share: progress(0.1 + 0.5 * share))
    best = ledger.best
    for subset in _subsets(best.members)[1:-1]:  # another start, another minimum
        (refitted,) = problem.refit([(ledger, subset, problem.start(ledger, subset))])
        if refitted.evidence > best.evidence:
            ledger.keep(refitted)
    problem.cost = 0.0
    tried = {
        members: replace(hypothesis, evidence=hypothesis.evidence + COST * len(members))
        for members, hypothesis in ledger.tried.items()
    }

    def worth(hypothesis: Hypothesis[Fit]) -> float:
        return hypothesis.evidence - COST * len(hypothesis.members)

    finished: set[Members] = set()
    for _ in range(2):
        order = sorted((h for h in tried.values() if h.members), key=worth, reverse=True)
        rivals = [
            hypothesis
            for hypothesis in order[: _RIVALS + 1]
            if worth(hypothesis) > worth(order[0]) - _CLOSE
        ]
        subsets = [tried[smaller] for smaller in _without_one(order[0].members) if smaller in tried]
        for hypothesis in {h.members: h for h in [*rivals, *subsets] if h.members}.values():
            if hypothesis.members not in finished:
                tried[hypothesis.members] = _marked(
                    problem.converged(hypothesis, 1 if hypothesis.fit.local else 2)
                )
                finished.add(hypothesis.members)
    progress(1.0)
    order = sorted(tried.values(), key=worth, reverse=True)
    return tried, order, next(hypothesis for hypothesis in order if hypothesis.members)


def changed(problem: TwinSwims, x: Array, simulated: Model | None = None) -> list[Array]:
    """Change of each swim's signals by the effects at a point (F,), in the twin, (T, 3 + J).

    Without camera effects and the current, which are exact. Effects of the model that the fluid
    simulated count by the difference from their sizes in it.
    """
    c = problem.coordinates
    full = c.model_at(x)
    shown = {column.name for column in c.columns if column.shown}
    kept = {name: v for name, v in values(full).items() if name in shown}
    kept |= values(simulated) if simulated else {}
    without = replace(full, body={**full.body, "effects": listed(kept)})
    signals = [signals_of([full, without], swim, problem.simulate) for swim in problem.swims]
    return [pair[0] - pair[1] for pair in signals]


def _marked(hypothesis: Hypothesis[Fit]) -> Hypothesis[Fit]:
    return replace(hypothesis, fit=replace(hypothesis.fit, local=True))


def _subsets(members: Members) -> list[Members]:
    """Every subset of a set, with the empty set and the set itself."""
    effects = sorted(members, key=str)
    return [frozenset(s) for n in range(len(effects) + 1) for s in combinations(effects, n)]


def _without_one(members: Members) -> list[Members]:
    """The set without one of its members, for each member."""
    return [members - {effect} for effect in sorted(members, key=str)]


def _held_out(problem: TwinSwims, hypothesis: Hypothesis[Fit]) -> HeldOutErrors:
    """Held-out errors of a set on the end of the swims, fitted to their beginning."""
    fit, held_out = problem.held(hypothesis.members, hypothesis.fit, HELD_OUT)
    rows = fit.rows
    loss = 0.5 * float(np.sum(rows[held_out] ** 2))
    square, count, row = 0.0, 0, 0
    for weight in problem.weights:
        n = weight.size
        error = (rows[row : row + n] * held_out[row : row + n]).reshape(weight.shape)
        square += float(np.sum((error[:, :2] / weight[:, :2]) ** 2))
        count += int(held_out[row : row + n].reshape(weight.shape)[:, 0].sum())
        row += n
    return HeldOutErrors(fit, loss, float(np.sqrt(square / max(count, 1))))


def _misfit(problem: TwinSwims, hypothesis: Hypothesis[Fit]) -> Array:
    """Mean square of the residuals, less the estimated error of the twin, shape (4, 3)."""
    rows = hypothesis.fit.rows + hypothesis.fit.near.slope @ problem.seems(
        hypothesis.members, hypothesis.fit
    )
    sums, counts, row = np.zeros((4, 3)), np.zeros((4, 3)), 0
    for blocks, weight in zip(problem.blocks, problem.weights, strict=True):
        squares = rows[row : row + weight.size].reshape(weight.shape) ** 2
        row += weight.size
        for k in range(weight.shape[1]):
            np.add.at(sums[min(k, 3)], blocks.band, squares[:, k])
            np.add.at(counts[min(k, 3)], blocks.band, 1.0)
    return sums / np.maximum(counts, 1.0)


def raw(found: Searched, *, referred: bool) -> dict[str, Any]:
    """The input of ``swim_decision.decide``, in types of JSON, from which thresholds are fitted."""
    return {
        "sets": [
            {"names": [list(n) for n in result.names], "evidence": result.evidence,
             "settled": result.settled}
            for result in found.table()
        ],
        "nameless": found.nameless,
        "held": [
            {"names": [list(n) for n in names_of(m)], "loss": result.loss, "speed": result.speed}
            for m, result in found.held.items()
        ],
        "misfit": found.misfit.tolist(),
        "referred": referred,
        "repeated": poses.repeated(found.problem.swims),
        "rollouts": found.problem.rollouts,
    }  # fmt: skip
