"""Search for the effects that are missing in swims, before probabilities are computed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from sim.inference.coordinates import is_shown, signals_of
from sim.inference.signal_error import kinds_of
from sim.inference.swim_problem import COST, LOST, Fit, SwimPrior, SwimProblem
from sim.inference.unlisted import gains
from sim2real.arrays import Array
from sim2real.body import listed, values
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, Members, select
from sim2real.model import Model
from sim2real.progress import Progress

HELD_OUT = 0.3
"""Share of each swim, at its end, on which predictions are compared."""
_SHARE, _LATE_S = 0.1, 0.01
"""Relative error, and delay in s, of the change that an effect makes."""


class HeldOutErrors(NamedTuple):
    """A fit to the beginning of swims, its loss on their end, and its error of the speed there."""

    fit: Fit
    loss: float
    speed: float


@dataclass(frozen=True)
class Searched:
    """Result of a search, before decisions."""

    problem: SwimProblem  # the swims
    found: dict[Members, Hypothesis[Fit]]  # every set that was tried, best first
    plain: Hypothesis[Fit]  # the fit without effects
    best: Hypothesis[Fit]  # the best set with an effect, likely or not
    held: dict[Members, HeldOutErrors]  # held-out errors of each subset of the best that was tried
    # the input of ``swim_decision.decide``, from which thresholds are fitted, in types of JSON: the
    # evidence of each set, that of unnamed shapes beside the plain fit and the best, held-out
    # errors, and the mean square of the best fit's weighted errors by signal and band, less the
    # estimated error of the twin (4, 3)
    raw: dict[str, Any]


def searched(
    problem: SwimProblem,
    progress: Progress = lambda share: None,
    simulated: Model | None = None,
    *,
    referred: bool = False,
) -> Searched:
    """Try sets of effects on swims of one robot, with a prior from ``learned``.

    The twin predicts a strong effect with an error in proportion to its change; a second search
    counts it as noise, except for effects of ``simulated``, the model that the fluid simulated.
    ``referred``: the prior has reference swims.
    """
    found = _search(problem, lambda share: progress(0.5 * share))
    if "water" in problem.coordinates.model.body:
        best = next(h for h in found if h.members)
        changes = changed(problem, best.fit.x, simulated)
        parts = zip(changes, problem.blocks, problem.weights, strict=True)
        size = sum(float(np.sum(b.about(change) * w**2)) for change, b, w in parts)
        if 0.5 * _SHARE**2 * size > 3.0:  # log-evidence from which such an error counts as noise
            problem = replace(problem, prior=doubtful(problem, changes))
            found = _search(problem, lambda share: progress(0.5 + 0.4 * share))
    tried = {hypothesis.members: hypothesis for hypothesis in found}
    plain, best = tried[frozenset()], next(h for h in found if h.members)
    held = {s: _held_out(problem, tried[s]) for s in _subsets(best.members) if s in tried}
    sets = [
        {"names": sorted(map(list, h.members)), "settled": h.fit.local,
         "evidence": h.evidence + COST * len(h.members) - plain.evidence}
        for h in found
    ]  # fmt: skip
    raw = {
        "sets": sets,
        "nameless": {
            name: gains(problem, h.members, h.fit) for name, h in (("plain", plain), ("best", best))
        },
        "held": [
            {"names": sorted(map(list, members)), "loss": errors.loss, "speed": errors.speed}
            for members, errors in held.items()
        ],
        "misfit": problem.misfit(best.members, best.fit).tolist(),
        "referred": referred,
        "repeated": problem.repeated,
    }
    progress(1.0)
    return Searched(problem, tried, plain, best, held, raw)


def _search(problem: SwimProblem, progress: Progress) -> list[Hypothesis[Fit]]:
    """Every set that was tried, of at most two effects besides lost frames, best first."""
    ledger: Ledger[Fit] = Ledger(0)
    ledger.keep(problem.plain())
    progress(0.1)
    lost = LOST in problem.coordinates.effects and problem.counted(frozenset({LOST})) > 0
    breadth = Breadth(most=2 + lost, added=5, rivals=3, within=np.inf)
    select(problem, [ledger], breadth, lambda share: progress(0.1 + 0.5 * share))
    for subset in _subsets(ledger.best.members)[1:-1]:  # another start, another minimum
        for hypothesis in problem.refit([(ledger, subset, problem.start(ledger, subset))]):
            ledger.keep(hypothesis)
    first, *others = sorted((h for h in ledger.tried.values() if h.members), key=_evidence)
    near = [h.members for h in others[:4] if h.evidence > first.evidence - 10.0]
    # those near the best are fitted until new derivatives hardly change their loss
    for members in {*near, *_subsets(first.members)[1:]} & ledger.tried.keys():
        for _ in range(3):
            fit = ledger.tried[members].fit
            ledger.tried[members] = problem.refined(members, fit, fit)
            if abs(fit.loss - ledger.tried[members].fit.loss) < 0.7:
                break
    progress(1.0)
    return sorted(ledger.tried.values(), key=_evidence)


def _evidence(hypothesis: Hypothesis[Fit]) -> float:
    """Key to sort by, best first."""
    return -hypothesis.evidence


def _subsets(members: Members) -> list[Members]:
    """Every subset of a set, the empty set first, the set itself last."""
    effects = sorted(members)
    return [frozenset(s) for n in range(len(effects) + 1) for s in combinations(effects, n)]


def changed(problem: SwimProblem, x: Array, simulated: Model | None = None) -> list[Array]:
    """Change of each swim's signals by the effects at a point (F,), in the twin, (T, 3 + J)."""
    c = problem.coordinates
    full, base = c.model_at(x), c.model_at(np.where(c.in_fit(frozenset()), x, c.nominal))
    kept = {name: v for name, v in values(full).items() if is_shown(name)}
    kept |= values(simulated) if simulated else {}
    joints = full.joints if simulated else base.joints
    without = replace(full, joints=joints, body={**full.body, "effects": listed(kept)})
    pairs = (signals_of([full, without], swim, problem.simulate) for swim in problem.swims)
    return [with_effects - bare for with_effects, bare in pairs]


def doubtful(problem: SwimProblem, changes: Sequence[Array]) -> SwimPrior:
    """The prior with larger errors of the simulator, in proportion to these changes."""
    recorded, prior = [swim.signals for swim in problem.swims], problem.prior
    size, of_signal = (
        np.sqrt(np.nanmean(np.concatenate(x) ** 2, axis=0)) for x in (changes, recorded)
    )
    ratio = np.nan_to_num(size / of_signal)
    sd = {
        name: (_LATE_S if kind == "late" else _SHARE) * float(ratio[k])
        for name, (k, kind) in kinds_of(size.size - 3).items()
        if not kind.startswith("off")
    }
    more = np.array([sd.get(column.name, 0.0) for column in problem.coordinates.columns])
    covariance = prior.covariance + np.diag(more**2)
    shares = np.hypot(prior.shares, _SHARE * np.append(ratio[:3], ratio[3:].mean())[:, None])
    return SwimPrior(prior.mean, covariance, np.hypot(prior.imitation, more), shares)


def _held_out(problem: SwimProblem, hypothesis: Hypothesis[Fit]) -> HeldOutErrors:
    """Held-out errors of a set on the end of the swims, fitted to their beginning."""
    fit, left_out = problem.held(hypothesis.members, hypothesis.fit, HELD_OUT)
    rows = np.where(left_out, problem.rows(fit.x[None])[0], 0.0)
    square, count = 0.0, 0
    parts = problem.of_swims(rows), problem.of_swims(left_out.astype(np.float64)), problem.weights
    for error, left, weight in zip(*parts, strict=True):
        square += float(np.sum((error[:, :2] / weight[:, :2]) ** 2))
        count += int(left[:, 0].sum())
    return HeldOutErrors(fit, 0.5 * float(rows @ rows), float(np.sqrt(square / max(count, 1))))
