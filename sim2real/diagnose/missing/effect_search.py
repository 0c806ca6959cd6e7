"""Which effects does each joint need? The servo's side of the search of ``inference.selection``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.nuisances import first_look, with_nuisances, with_rivals
from sim2real.diagnose.missing.screening import FITTED
from sim2real.diagnose.missing.servo_search import Job, SearchLimits, ServoSearch, ledgers_of
from sim2real.diagnose.rival_sets import StatedSet
from sim2real.effects import named
from sim2real.identification.servo_problem import Fits, Hypothesis, Set, Tried
from sim2real.inference import selection
from sim2real.progress import Progress
from sim2real.servo.batch import Batch


def search(
    batch: Batch,
    plain: Fits,
    *,
    level: float,
    rng: np.random.Generator,
    noise: Sequence[float] | None = None,
    bases: Sequence[Set] | None = None,
    best: Sequence[Hypothesis] | None = None,
    needed: bool = True,
    stated: Sequence[Sequence[StatedSet]] | None = None,
    effort: float = 1.0,
    progress: Progress = lambda share: None,
) -> tuple[list[Tried], ServoSearch]:
    """Try sets of effects on every joint until none is better.

    Args:
        batch: The recordings.
        plain: The fit of the plain servo, one a joint.
        level: Share of joints with nothing missing that may be searched beyond single effects.
        rng: For the bootstrap.
        noise: Standard deviation of each joint's sensor, rad; where it is not known, nothing is
            taken for granted but the plain servo.
        bases: Effects that each joint's given model has.
        best: What explained each joint best before; looked for where None.
        needed: Whether to search at all; joints that are compared with references need no search.
        stated: Sets that are tried in any case, one sequence a joint, with where to start.
        effort: Multiple of the simulation budget.
        progress: Called with the share that is done.

    Returns:
        What was tried, one a joint, and what may be asked of it further.
    """
    ledgers = ledgers_of(plain, bases)
    problem = ServoSearch(batch, level, rng, limits=SearchLimits(effort=effort))
    if not needed:
        return ledgers, problem
    large = [DECISION.nuisance_finding_size * sd for sd in noise or ()]
    if noise is not None:
        if best is None:
            first_look(problem, ledgers, large)
        before = best or [ledger.best for ledger in ledgers]
        ledgers = with_nuisances(problem, ledgers, large, before)
        jobs = [
            (ledger, ledger.base | h.members, h.fit.servos.theta[0])
            for ledger, h in zip(ledgers, before, strict=True)
            if not h.members <= ledger.base
        ]
        for (ledger, _, _), hypothesis in zip(jobs, problem.refit(jobs), strict=True):
            ledger.keep(hypothesis)
    jobs = [
        (ledger, ledger.base | one.effects, one.theta)
        for ledger, sets in zip(ledgers, stated or [()] * len(ledgers), strict=True)
        for one in sets
    ]
    for (ledger, _, _), hypothesis in zip(jobs, problem.refit(jobs), strict=True):
        ledger.keep(hypothesis)
    progress(0.15)
    selection.select(problem, ledgers, selection.Breadth(most=1))
    progress(0.3)
    rebased = problem.rebased(ledgers)
    if rebased:
        selection.select(problem, rebased, selection.Breadth(most=1))
    missing = [x for x in ledgers if x.best.members != x.base and not problem.exhausted(x)]
    jobs = _pairs_of_families(problem, missing)
    for (ledger, _, _), hypothesis in zip(jobs, problem.refit(jobs), strict=True):
        ledger.keep(hypothesis)
    problem.singles = False
    selection.select(
        problem,
        ledgers,
        progress=lambda share: progress(0.4 + 0.5 * share),
        exhausted=problem.exhausted,
    )
    if noise is not None:
        # Where the plain servo is likeliest no effect is named, and no rival matters.
        going = [
            k
            for k, ledger in enumerate(ledgers)
            if ledger.best.members != ledger.base and not problem.exhausted(ledger)
        ]
        some, angles = [ledgers[k] for k in going], [large[k] for k in going]
        changed = with_rivals(problem, some, angles)
        selection.select(problem, changed, exhausted=problem.exhausted)
    problem.release(ledgers)
    return ledgers, problem


def search_again(problem: ServoSearch, ledgers: Sequence[Tried]) -> None:
    """Try every effect together with the likeliest set of each joint, until no set is likelier.

    For joints whose likeliest set leaves structure in the residual: a noise model that has taken up
    structure hides an effect from the linear look that chooses what is tried, and the nuisances
    that were held before ``release`` favour the set with which they were fitted.

    Args:
        problem: The search so far, with nothing held.
        ledgers: What was tried on these joints.
    """
    some = [ledger for ledger in ledgers if not problem.exhausted(ledger)]
    problem.singles = True
    problem.held = {ledger.case: problem.released.get(ledger.case, frozenset()) for ledger in some}
    selection.widen(problem, some)
    problem.release(some)


def _pairs_of_families(
    problem: ServoSearch, ledgers: Sequence[Tried], *, share: float = 0.5
) -> list[Job]:
    """Pairs of effects of one family, each started from the fit of its likelier member alone.

    Either member alone takes up much of the other, so that an effect of another family may be
    likelier than each, and the pair would not be reached from the likeliest single effects.
    """
    alone: list[tuple[Tried, str, Set]] = []
    for ledger in ledgers:
        least = ledger.plain.evidence + share * (ledger.best.evidence - ledger.plain.evidence)
        families: dict[str, Set] = {}
        for hypothesis in sorted(ledger.tried.values(), key=lambda h: h.evidence):
            added = hypothesis.members - ledger.base
            if len(added) == 1 and hypothesis.evidence > least and _has_partner(*added):
                families[named(*added).family] = hypothesis.members
        alone += [(ledger, family, members) for family, members in families.items()]
    problem.look([(ledger, members) for ledger, _, members in alone])
    return [
        (ledger, members | {name}, start)
        for ledger, family, members in alone
        for name, start in problem.additions(ledger, members, len(FITTED))
        if named(name).family == family
    ]


def _has_partner(effect: str) -> bool:
    """Whether another effect of the family of this one can be present with it."""
    one = named(effect)
    return any(one.family == e.family != "" and not one.excludes(e) for e in FITTED)
