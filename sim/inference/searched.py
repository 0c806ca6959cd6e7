"""Search for the effects that are missing in swims, before probabilities are computed.

The search is ``sim2real.inference.selection`` on the problem of ``twin_search``: every effect of
the catalogue is fitted together with servos and force law, and the error of the twin counts as
noise. An effect is reported if it predicts the end of each swim better when fitted to the
beginning. Effects that imitate one another form a group. Where an unnamed shape (``unlisted``) fits
better than all effects, the diagnosis abstains. Thresholds are in ``law_error.json``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.calibration.swim_parameters import Candidate
from sim.inference import poses
from sim.inference.coordinates import Coordinates, Swum, seen_as
from sim.inference.discrepancy import SHARE
from sim.inference.law_error import LAW_ERROR, NEVER, LawError
from sim.inference.linear_fit import together
from sim.inference.swims import Swim
from sim.inference.twin_search import Fit, SwimPrior, TwinSwims
from sim.inference.unlisted import gains
from sim2real.body import listed, values
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, Members, select
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]

MOST = 2
"""Largest number of effects of a set, lost frames not counted."""
COST = 3.422
"""Log-evidence that an effect must gain in the search; probabilities are computed later."""
HELD_OUT = 0.3
"""Share of each swim, at its end, on which predictions are compared."""
_ITS_OWN = (0.5, 6.0)
"""Limits of the mean square error of the twin for one robot, relative to the usual one."""
_SCALES = (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)
"""Scales of the variation between swims of a robot that are compared."""
_ROUNDS = 1
"""Times that the common part of the error is estimated again, linearised anew."""
_RIVALS = 4
_DOUBTFUL = 3.0
"""Log-evidence above which an error of a strong effect counts as noise."""
_CLOSE = 10.0
"""Log-evidence within which a rival is fitted as carefully as the best set."""


@dataclass(frozen=True)
class TriedSet:
    """One set of effects, as far as decisions need it.

    Attributes:
        names: Effects as ``(name, component)``.
        evidence: Logarithm, above that of nothing missing, before any cost.
        settled: Whether it was fitted to the end.
    """

    names: tuple[tuple[str, str], ...]
    evidence: float
    settled: bool


class HeldOutErrors(NamedTuple):
    """What a fit to the beginning of the swims predicts of their end.

    Attributes:
        fit: To the beginning.
        loss: Of the end.
        speed: Error of the speed over ground there, m/s.
    """

    fit: Fit
    loss: float
    speed: float


@dataclass(frozen=True)
class Searched:
    """What a search found, before anything is decided.

    Attributes:
        problem: The swims.
        plain: The fit with nothing missing.
        found: Every set that was tried, best first.
        best: The best of them that has an effect, be it worth saying or not.
        nameless: Evidence that shapes without a name add to the plain fit and to the best.
        held: By set, what it predicts that it has not seen.
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
        """All sets."""
        zero = self.plain.evidence
        return [
            TriedSet(names_of(one.members), one.evidence - zero, one.fit.looked)
            for one in self.found
        ]


def names_of(members: Members) -> tuple[tuple[str, str], ...]:
    """Effects of a set, as names and components."""
    listed: list[Candidate] = list(members)
    return tuple(sorted((one.name, one.component) for one in listed))


def learned(
    references: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: Swum,
    known: LawError = LAW_ERROR,
) -> SwimPrior:
    """Prior of a robot's swims, learned from reference swims in which nothing is missing.

    Without reference swims it is the prior of all robots, with a larger error of the twin.
    """
    coordinates = Coordinates.of(robot, model)
    mean, covariance = known.prior(coordinates)
    imitation = known.imitation(coordinates)
    usual = SwimPrior(mean, covariance, imitation, known.shares)
    if not references:
        return replace(usual, shares=known.decisions["unreferred"] * known.shares)
    problem = TwinSwims(coordinates, references, simulate, usual)
    found = problem.plain()
    wrong = np.sqrt(np.clip(_misfit(problem, found), *_ITS_OWN))
    there, spread, scale = _shared(problem, found.fit, usual)
    for _ in range(_ROUNDS):
        problem = TwinSwims(coordinates, references, simulate, replace(usual, mean=there))
        there, spread, scale = _shared(problem, problem.at(problem.centre(frozenset())), usual)
    imitation = scale * imitation
    return SwimPrior(there, spread + np.diag(imitation**2), imitation, known.shares * wrong)


def _shared(problem: TwinSwims, fit: Fit, usual: SwimPrior) -> tuple[Array, Array, float]:
    """Parameters common to the swims of a robot (F,), their covariance, and the scale of the rest.

    A linear mixed model about a fit (Laird and Ware, Biometrics 38 (1982) 963): each swim has
    parameters of its own, distributed about those of the robot. The scale of their distribution,
    relative to the usual one, is the likeliest of ``_SCALES``.
    """
    own = np.square(usual.imitation)
    common = usual.covariance - np.diag(own)
    least = np.square(NEVER * np.array([c.step for c in problem.coordinates.columns]))
    known = np.linalg.inv(common + np.diag(np.maximum(least - np.diag(common), 0.0)))
    here = fit.x + problem.coordinates.seems
    parts, at = [], 0
    for weight in problem.weights:
        part = fit.near.slope[at : at + weight.size]
        parts.append((part.T @ part, part.T @ fit.rows[at : at + weight.size]))
        at += weight.size
    best = -np.inf
    told: tuple[Array, Array, float] = (here, common, 1.0)
    for scale in _SCALES:
        whole, slope, inner = together(parts, scale**2 * own)
        whole, pull = whole + known, known @ (usual.mean - here) - slope
        worth = 0.0
        for (_, gradient), each in zip(parts, inner, strict=True):
            size = np.log(scale**2 * own).sum() - np.linalg.slogdet(each)[1]
            worth += 0.5 * float(gradient @ each @ gradient) - 0.5 * float(size)
        spread: Array = np.asarray(np.linalg.inv(whole), dtype=np.float64)
        worth += 0.5 * float(pull @ spread @ pull) - 0.5 * float(np.linalg.slogdet(whole)[1])
        if worth > best:
            best, told = worth, (here + spread @ pull, spread, scale)
    return told


def searched(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: Swum,
    prior: SwimPrior,
    progress: Callable[[float], None] = lambda share: None,
    begun: Model | None = None,
) -> Searched:
    """Try sets of effects on swims of one robot.

    The twin predicts a strong effect with an error in proportion to the change that the effect
    makes. Where the fluid was simulated and the best set changes much, a second search counts this
    error as noise. It is not used with the twin alone, where it has not been graded.

    Args:
        swims: The recordings.
        model: The servos, and the law where the fluid has swum.
        robot: The robot.
        simulate: The twin, alone or corrected by the fluid.
        prior: Prior of servos, force law and effects, see ``learned``.
        progress: Called with the share that is done.
        begun: Model that the fluid simulated; its effects have no such error.
    """
    problem = TwinSwims(Coordinates.of(robot, model), swims, simulate, prior)
    tried, order, best = _tried(problem, lambda share: progress(0.5 * share))
    if "water" in model.body:
        doubted = changed(problem, best.fit.x, begun)
        weighed = zip(doubted, problem.blocks, problem.weights, strict=True)
        size = sum(float(np.sum(b.about(change) * w**2)) for change, b, w in weighed)
        if 0.5 * SHARE**2 * size > _DOUBTFUL:
            problem = TwinSwims(Coordinates.of(robot, model), swims, simulate, prior,
                                doubted=doubted)  # fmt: skip
            tried, order, best = _tried(problem, lambda share: progress(0.5 + 0.4 * share))
    plain = tried[frozenset()]
    held = {}
    for members in _subsets(best.members):
        if members in tried:
            held[members] = _held(problem, tried[members])
    nameless = {"plain": gains(problem, plain.members, plain.fit)}
    nameless["best"] = gains(problem, best.members, best.fit)
    progress(1.0)
    return Searched(problem, plain, order, best, nameless, held, _misfit(problem, best))


def _tried(
    problem: TwinSwims, progress: Callable[[float], None]
) -> tuple[dict[Members, Hypothesis[Fit]], list[Hypothesis[Fit]], Hypothesis[Fit]]:
    """Every set that was tried; the same, best first; the best of them that has an effect."""
    plain = problem.plain()
    progress(0.1)
    ledger: Ledger[Fit] = Ledger(0)
    ledger.keep(plain)
    most = MOST + any(problem.counted(frozenset({e})) > 0 for e in problem.coordinates.effects)
    breadth = Breadth(most=most, added=5, rivals=3, within=np.inf)
    problem.cost = COST
    select(problem, [ledger], breadth, lambda share: progress(0.1 + 0.5 * share))
    best = ledger.best
    for part in _subsets(best.members)[1:-1]:  # begun from nothing it may have ended elsewhere
        (found,) = problem.refit([(ledger, part, problem.start(ledger, part))])
        if found.evidence > best.evidence:
            ledger.keep(found)
    problem.cost = 0.0
    tried = {
        members: replace(one, evidence=one.evidence + COST * len(members))
        for members, one in ledger.tried.items()
    }

    def worth(one: Hypothesis[Fit]) -> float:
        return one.evidence - COST * len(one.members)

    done: set[Members] = set()
    for _ in range(2):
        order = sorted((h for h in tried.values() if h.members), key=worth, reverse=True)
        close = [one for one in order[: _RIVALS + 1] if worth(one) > worth(order[0]) - _CLOSE]
        parts = [tried[p] for p in _parts(order[0].members) if p in tried]
        for one in {h.members: h for h in [*close, *parts] if h.members}.values():
            if one.members not in done:
                tried[one.members] = _looked(problem.settled(one, 1 if one.fit.looked else 2))
                done.add(one.members)
    progress(1.0)
    order = sorted(tried.values(), key=worth, reverse=True)
    return tried, order, next(one for one in order if one.members)


def changed(problem: TwinSwims, x: Array, begun: Model | None = None) -> list[Array]:
    """What effects at a point (F,) change of each swim by the twin, (T, 3 + J).

    Not those of the camera and a current, which are exact; of ``begun``, with which the fluid swam,
    what they are more or less than there.
    """
    c = problem.coordinates
    full = c.model_at(x)
    shown = {column.name for column in c.columns if column.shown}
    there = {name: v for name, v in values(full).items() if name in shown}
    there |= values(begun) if begun else {}
    without = replace(full, body={**full.body, "effects": listed(there)})
    said = [seen_as([full, without], swim, problem.simulate) for swim in problem.swims]
    return [one[0] - one[1] for one in said]


def _looked(one: Hypothesis[Fit]) -> Hypothesis[Fit]:
    return replace(one, fit=replace(one.fit, looked=True))


def _subsets(members: Members) -> list[Members]:
    """Every part of a set, nothing and itself among them."""
    every = sorted(members, key=str)
    return [frozenset(s) for n in range(len(every) + 1) for s in combinations(every, n)]


def _parts(members: Members) -> list[Members]:
    """A set without each of its members."""
    return [members - {one} for one in sorted(members, key=str)]


def _held(problem: TwinSwims, one: Hypothesis[Fit]) -> HeldOutErrors:
    """What a set predicts of the end of the swims, fitted to their beginning."""
    fit, left = problem.held(one.members, one.fit, HELD_OUT)
    rows = fit.rows
    loss = 0.5 * float(np.sum(rows[left] ** 2))
    square, count, at = 0.0, 0, 0
    for weight in problem.weights:
        n = weight.size
        error = (rows[at : at + n] * left[at : at + n]).reshape(weight.shape)
        square += float(np.sum((error[:, :2] / weight[:, :2]) ** 2))
        count += int(left[at : at + n].reshape(weight.shape)[:, 0].sum())
        at += n
    return HeldOutErrors(fit, loss, float(np.sqrt(square / max(count, 1))))


def _misfit(problem: TwinSwims, one: Hypothesis[Fit]) -> Array:
    """Mean square of what is left, that which seems to be of the twin's error taken off, (4, 3)."""
    rows = one.fit.rows + one.fit.near.slope @ problem.seems(one.members, one.fit)
    sums, counts, at = np.zeros((4, 3)), np.zeros((4, 3)), 0
    for blocks, weight in zip(problem.blocks, problem.weights, strict=True):
        left = rows[at : at + weight.size].reshape(weight.shape) ** 2
        at += weight.size
        for k in range(weight.shape[1]):
            np.add.at(sums[min(k, 3)], blocks.band, left[:, k])
            np.add.at(counts[min(k, 3)], blocks.band, 1.0)
    return sums / np.maximum(counts, 1.0)


def raw(found: Searched, *, referred: bool) -> dict[str, Any]:
    """What decisions are made from, as JSON takes it: thresholds can be read off many of these."""
    return {
        "sets": [
            {"names": [list(n) for n in one.names], "evidence": one.evidence,
             "settled": one.settled}
            for one in found.table()
        ],
        "nameless": found.nameless,
        "held": [
            {"names": [list(n) for n in names_of(m)], "loss": one.loss, "speed": one.speed}
            for m, one in found.held.items()
        ],
        "misfit": found.misfit.tolist(),
        "referred": referred,
        "repeated": poses.repeated(found.problem.swims),
        "rollouts": found.problem.rollouts,
    }  # fmt: skip
