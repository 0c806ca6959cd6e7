"""Search for the effects that are missing in swims, before probabilities are computed.

One batch of rollouts predicts the gain of every effect near a fit, and the most promising are
fitted, together with servos and force law.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from sim.inference.coordinates import Coordinates, signals_of
from sim.inference.law_error import LAW_ERROR, NEVER, LawError
from sim.inference.signal_error import SHARE, of_changes
from sim.inference.swim_parameters import Name, Names
from sim.inference.swim_problem import Fit, SwimPrior, SwimProblem, repeated
from sim.inference.swims import Swim, SwimSimulator
from sim.inference.unlisted import gains
from sim2real.arrays import Array
from sim2real.body import listed, values
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, Members, select
from sim2real.model import Model
from sim2real.progress import Progress
from sim2real.robot import Robot

FIRST = 8
"""Number of single effects that are refitted, those with the largest predicted evidence."""
MOST = 2
"""Largest number of effects of a set, lost frames not counted."""
COST = 3.422
"""Log-evidence that an effect must gain in the search; probabilities are computed later."""
HELD_OUT = 0.3
"""Share of each swim, at its end, on which predictions are compared."""
_JUMPS = (-2.0, 2.0, 6.0)
"""Sizes of an effect that a fit may start from, in steps of its derivative."""
_CONVERGED = 0.7
"""Change of the loss by new derivatives below which a fit has converged."""
_ERROR_LIMITS = (0.5, 6.0)
"""Limits of the mean square error of the twin for one robot, relative to the usual one."""
_SCALES = (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)
"""Scales of the variation between swims of a robot that are compared."""
_RIVALS = 4
_DOUBTFUL = 3.0
"""Log-evidence above which an error of a strong effect counts as noise."""
_CLOSE = 10.0
"""Log-evidence within which a rival is fitted to convergence, as the best set is."""


class SwimSearch(SwimProblem):
    """Swims of one robot as a problem of ``sim2real.inference.selection``."""

    def look(self, places: Sequence[tuple[Ledger[Fit], Members]]) -> None:
        """Linearise the fits of these sets, and continue them."""
        for ledger, members in places:
            hypothesis = ledger.tried[members]
            if not hypothesis.fit.local:
                refined = self.refined(members, hypothesis.fit)
                ledger.tried[members] = replace(refined, fit=replace(refined.fit, local=True))

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, Fit]]:
        """Effects with the largest predicted evidence when added to a set, by its linear model."""
        fits = [ledger.tried[members].fit, *([] if members else self.first_fits)]
        promise: dict[Name, float] = {}
        for effect in self.coordinates.effects:
            if effect not in members:
                more = members | {effect}
                promise[effect] = max(self.evidence(more, self.linear(more, fit)) for fit in fits)
        order = sorted(promise, key=lambda effect: -promise[effect])
        return [(effect, fits[0]) for effect in order[: most or FIRST]]

    def start(self, ledger: Ledger[Fit], members: Members) -> Fit:
        """The best fit, with the columns of effects outside ``members`` reset."""
        best = ledger.best
        keep = self.coordinates.in_fit(members)
        x = np.where(keep, best.fit.x, self.coordinates.nominal)
        return replace(best.fit, x=x, rows=self.rows(x[None])[0])

    def refit(self, jobs: Sequence[tuple[Ledger[Fit], Members, Fit]]) -> list[Hypothesis[Fit]]:
        """Fit sets, each started from a fit of a subset, with one batch of simulations per step."""
        initial = [(members, fit) for _, members, fit in jobs]
        singles = [members for _, members, _ in jobs if len(members) == 1]
        initial += [(members, fit) for members in singles for fit in self.first_fits]
        initial = self._with_other_sizes(initial)
        best: dict[Members, Fit] = {}
        for (members, _), fit in zip(initial, self.fitted(initial), strict=True):
            if members not in best or fit.loss < best[members].loss:
                best[members] = fit
        return [
            Hypothesis(members, best[members], self.evidence(members, best[members]))
            for _, members, _ in jobs
        ]

    def _with_other_sizes(
        self, initial: Sequence[tuple[Members, Fit]]
    ) -> list[tuple[Members, Fit]]:
        """Starts with another size of an effect of one parameter, where that predicts less loss."""
        c = self.coordinates
        of, trials = [], []
        for k, (members, fit) in enumerate(initial):
            for own in map(c.of_effect, members):
                for size in _JUMPS if len(own) == 1 and fit.x[own[0]] == 0.0 else ():
                    of.append(k)
                    trials.append(fit.x.copy())
                    trials[-1][own] = size * c.columns[own[0]].step
        out, best = list(initial), [self.linear(*start).loss for start in initial]
        points = c.clipped(np.array(trials).reshape(-1, len(c.columns)))
        for k, x, rows in zip(of, points, self.rows(points) if of else (), strict=True):
            start = initial[k][0], replace(initial[k][1], x=x, rows=rows)
            predicted = self.linear(*start).loss
            if predicted < best[k]:
                best[k], out[k] = predicted, start
        return out

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether the best set has effects, so that the search continues."""
        return bool(ledger.best.members)

    def converged(self, hypothesis: Hypothesis[Fit], rounds: int = 3) -> Hypothesis[Fit]:
        """The hypothesis, linearised and refitted until its loss no longer changes."""
        for _ in range(rounds):
            loss = hypothesis.fit.loss
            hypothesis = self.refined(hypothesis.members, hypothesis.fit, hypothesis.fit.near)
            if abs(loss - hypothesis.fit.loss) < _CONVERGED:
                break
        return replace(hypothesis, fit=replace(hypothesis.fit, local=True))


class HeldOutErrors(NamedTuple):
    """A fit to the beginning of swims, its loss on their end, and its error of the speed there."""

    fit: Fit
    loss: float
    speed: float


@dataclass(frozen=True)
class Searched:
    """Result of a search, before decisions."""

    problem: SwimSearch  # the swims
    plain: Hypothesis[Fit]  # the fit without effects
    found: list[Hypothesis[Fit]]  # every set that was tried, best first
    best: Hypothesis[Fit]  # the best set with an effect, likely or not
    # evidence that unnamed shapes add to the plain fit and to the best
    nameless: dict[str, dict[str, float]]
    held: dict[Members, HeldOutErrors]  # held-out errors of each set
    # mean square of the best fit's weighted errors by signal and band, less the estimated error of
    # the twin, shape (4, 3)
    misfit: Array

    def of(self, names: Names) -> Hypothesis[Fit]:
        """The set of these effects."""
        return next(h for h in self.found if h.members == names)


def learned(
    references: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    law_error: LawError = LAW_ERROR,
) -> SwimPrior:
    """A robot's prior, from reference swims in which nothing is missing, or that of all robots."""
    coordinates = Coordinates.of(robot, model)
    usual = law_error.prior(coordinates)
    if not references:
        return replace(usual, shares=law_error.decisions["unreferred"] * law_error.shares)
    problem = SwimProblem(coordinates, references, simulate, usual)
    plain = problem.plain()
    relative_error = np.sqrt(np.clip(_misfit(problem, plain), *_ERROR_LIMITS))
    common, _, _ = _common(problem, plain.fit, usual)
    problem = SwimProblem(coordinates, references, simulate, replace(usual, mean=common))
    common, spread, scale = _common(problem, problem.at(problem.centre(frozenset())), usual)
    imitation = scale * usual.imitation
    return SwimPrior(
        common, spread + np.diag(imitation**2), imitation, law_error.shares * relative_error
    )


def _common(problem: SwimProblem, fit: Fit, usual: SwimPrior) -> tuple[Array, Array, float]:
    """Parameters common to a robot's swims (F,), covariance, and likeliest scale of the rest.

    A linear mixed model about a fit (Laird and Ware, Biometrics 38 (1982) 963).
    """
    variance = np.square(usual.imitation)
    common = usual.covariance - np.diag(variance)
    least = np.square(NEVER * problem.coordinates.each("step"))
    precision = np.linalg.inv(common + np.diag(np.maximum(least - np.diag(common), 0.0)))
    point = fit.x + problem.coordinates.seems
    slopes, rows = problem.of_swims(fit.near.slope), problem.of_swims(fit.rows)
    flat = [(s.reshape(-1, point.size), r.ravel()) for s, r in zip(slopes, rows, strict=True)]
    parts = [(slope.T @ slope, slope.T @ row) for slope, row in flat]
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
        evidence += 0.5 * float(gradient @ posterior @ gradient)
        evidence -= 0.5 * float(np.linalg.slogdet(curvature)[1])
        if evidence > largest:
            largest, estimate = evidence, (point + posterior @ gradient, posterior, scale)
    return estimate


def together(
    parts: Sequence[tuple[Array, Array]], variance: Array
) -> tuple[Array, Array, list[Array]]:
    """Combine swims whose parameters vary about common ones (a linear mixed model).

    From curvature (F, F) and gradient (F,) of each swim's loss at one point, and the variance (F,)
    of a swim's parameters, to those of the sum, and the covariance of each swim's deviations.
    """
    covariances = [np.asarray(np.linalg.inv(normal + np.diag(1 / variance))) for normal, _ in parts]
    pairs = list(zip(parts, covariances, strict=True))
    curvature = sum(n - n @ covariance @ n for (n, _), covariance in pairs)
    gradient = sum(g - n @ covariance @ g for (n, g), covariance in pairs)
    return np.asarray(curvature), np.asarray(gradient), covariances


def searched(
    swims: Sequence[Swim],
    model: Model,
    robot: Robot,
    simulate: SwimSimulator,
    prior: SwimPrior,
    progress: Progress = lambda share: None,
    simulated: Model | None = None,
) -> Searched:
    """Try sets of effects on swims of one robot, with a prior from ``learned``.

    The twin predicts a strong effect with an error in proportion to its change; a second search
    counts it as noise, except for effects of ``simulated``, the model that the fluid simulated.
    """
    problem = SwimSearch(Coordinates.of(robot, model), swims, simulate, prior)
    order, best = _search(problem, lambda share: progress(0.5 * share))
    if "water" in model.body:
        changes = changed(problem, best.fit.x, simulated)
        parts = zip(changes, problem.blocks, problem.weights, strict=True)
        size = sum(float(np.sum(b.about(change) * w**2)) for change, b, w in parts)
        if 0.5 * SHARE**2 * size > _DOUBTFUL:
            wider = doubtful(problem, changes)
            problem = SwimSearch(Coordinates.of(robot, model), swims, simulate, wider)
            order, best = _search(problem, lambda share: progress(0.5 + 0.4 * share))
    tried = {hypothesis.members: hypothesis for hypothesis in order}
    plain = tried[frozenset()]
    held = {s: _held_out(problem, tried[s]) for s in _subsets(best.members) if s in tried}
    nameless = {
        name: gains(problem, h.members, h.fit) for name, h in (("plain", plain), ("best", best))
    }
    progress(1.0)
    return Searched(problem, plain, order, best, nameless, held, _misfit(problem, best))


def _search(
    problem: SwimSearch, progress: Progress
) -> tuple[list[Hypothesis[Fit]], Hypothesis[Fit]]:
    """Every set that was tried, sorted by evidence, and the best with an effect."""
    ledger: Ledger[Fit] = Ledger(0)
    ledger.keep(problem.plain())
    progress(0.1)
    most = MOST + any(problem.counted(frozenset({e})) > 0 for e in problem.coordinates.effects)
    breadth = Breadth(most=most, added=5, rivals=3, within=np.inf)
    problem.cost = COST
    select(problem, [ledger], breadth, lambda share: progress(0.1 + 0.5 * share))
    best = ledger.best
    for subset in _subsets(best.members)[1:-1]:  # another start, another minimum
        (refitted,) = problem.refit([(ledger, subset, problem.start(ledger, subset))])
        if refitted.evidence > best.evidence:
            ledger.keep(refitted)
    tried, finished = ledger.tried, set[Members]()
    for _ in range(2):
        first, *others = sorted((h for h in tried.values() if h.members), key=_evidence)
        close = [first.members]
        close += [h.members for h in others[:_RIVALS] if h.evidence > first.evidence - _CLOSE]
        close += [first.members - {effect} for effect in first.members]
        for members in close:
            if members and members in tried and members not in finished:
                tried[members] = problem.converged(tried[members])
                finished.add(members)
    problem.cost = 0.0
    progress(1.0)
    order = [
        replace(h, evidence=h.evidence + COST * len(h.members))
        for h in sorted(tried.values(), key=_evidence)
    ]
    return order, next(hypothesis for hypothesis in order if hypothesis.members)


def _evidence(hypothesis: Hypothesis[Fit]) -> float:
    """Key to sort by, best first."""
    return -hypothesis.evidence


def changed(problem: SwimProblem, x: Array, simulated: Model | None = None) -> list[Array]:
    """Change of each swim's signals by the effects at a point (F,), in the twin, (T, 3 + J)."""
    c = problem.coordinates
    full = c.model_at(x)
    shown = {column.name for column in c.columns if column.shown}
    kept = {name: v for name, v in values(full).items() if name in shown}
    kept |= values(simulated) if simulated else {}
    without = replace(full, body={**full.body, "effects": listed(kept)})
    signals = [signals_of([full, without], swim, problem.simulate) for swim in problem.swims]
    return [pair[0] - pair[1] for pair in signals]


def doubtful(problem: SwimProblem, changes: Sequence[Array]) -> SwimPrior:
    """The prior with larger errors of the simulator, in proportion to these changes."""
    recorded, prior = [swim.signals for swim in problem.swims], problem.prior
    size, of_signal = (
        np.sqrt(np.nanmean(np.concatenate(x) ** 2, axis=0)) for x in (changes, recorded)
    )
    ratio = np.nan_to_num(size / of_signal)
    sd = of_changes(size.size - 3, ratio)
    more = np.array([sd.get(column.name, 0.0) for column in problem.coordinates.columns])
    covariance = prior.covariance + np.diag(more**2)
    shares = np.hypot(prior.shares, SHARE * np.append(ratio[:3], ratio[3:].mean())[:, None])
    return SwimPrior(prior.mean, covariance, np.hypot(prior.imitation, more), shares)


def _subsets(members: Members) -> list[Members]:
    """Every subset of a set, the empty set first, the set itself last."""
    effects = sorted(members, key=str)
    return [frozenset(s) for n in range(len(effects) + 1) for s in combinations(effects, n)]


def _held_out(problem: SwimProblem, hypothesis: Hypothesis[Fit]) -> HeldOutErrors:
    """Held-out errors of a set on the end of the swims, fitted to their beginning."""
    fit, held_out = problem.held(hypothesis.members, hypothesis.fit, HELD_OUT)
    rows = np.where(held_out, fit.rows, 0.0)
    square = 0.0
    for error, weight in zip(problem.of_swims(rows), problem.weights, strict=True):
        square += float(np.sum((error[:, :2] / weight[:, :2]) ** 2))
    count = sum(part[:, 0].sum() for part in problem.of_swims(held_out.astype(np.float64)))
    return HeldOutErrors(fit, 0.5 * float(rows @ rows), float(np.sqrt(square / max(count, 1.0))))


def _misfit(problem: SwimProblem, hypothesis: Hypothesis[Fit]) -> Array:
    """Mean square of the residuals, less the estimated error of the twin, shape (4, 3)."""
    error = problem.seems(hypothesis.members, hypothesis.fit)
    return problem.misfit(hypothesis.fit.rows + hypothesis.fit.near.slope @ error)


def raw(found: Searched, *, referred: bool) -> dict[str, Any]:
    """The input of ``swim_decision.decide``, in types of JSON, from which thresholds are fitted."""
    zero = found.plain.evidence
    return {
        "sets": [
            {"names": [list(n) for n in sorted(h.members)], "evidence": h.evidence - zero,
             "settled": h.fit.local}
            for h in found.found
        ],
        "nameless": found.nameless,
        "held": [
            {"names": [list(n) for n in sorted(m)], "loss": result.loss, "speed": result.speed}
            for m, result in found.held.items()
        ],
        "misfit": found.misfit.tolist(),
        "referred": referred,
        "repeated": repeated(found.problem.swims),
    }  # fmt: skip
