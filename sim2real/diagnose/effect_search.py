"""Which effects does each joint need? The servo's side of the search of ``inference.selection``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.nuisances import with_nuisances, with_rivals
from sim2real.diagnose.screening import FITTED
from sim2real.diagnose.servo_search import Job, ServoSearch, plain_sets
from sim2real.effects import named
from sim2real.identification.servo_problem import Fits, Hypothesis, Set, Tried
from sim2real.inference import selection
from sim2real.progress import Progress
from sim2real.servo.batch import Batch


def search(
    batch: Batch,
    joints: Sequence[JointCase],
    plain: Fits,
    best: Sequence[Hypothesis],
    *,
    level: float,
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> tuple[list[Tried], ServoSearch]:
    """Try sets of effects on every joint until none is better, from what explained it best before.

    ``level`` is the share of joints that miss nothing and may be searched beyond single effects.

    Where all joints are compared with references, nothing is searched.

    Returns:
        What was tried, one a joint, and what may be asked of it further.
    """
    cases = plain_sets(plain, [joint.base for joint in joints])
    problem = ServoSearch(batch, level, rng, max(joint.effort for joint in joints))
    if all(joint.references for joint in joints):
        return cases, problem
    cases = with_nuisances(problem, cases, joints, best)
    problem.try_all(
        [
            (tried, tried.base | h.members, h.fit.servos.theta[0])
            for tried, h in zip(cases, best, strict=True)
            if not h.members <= tried.base
        ]
    )
    problem.try_all(
        [
            (tried, tried.base | one.effects, one.theta)
            for tried, joint in zip(cases, joints, strict=True)
            for one in joint.stated
        ]
    )
    progress(0.15)
    selection.select(problem, cases, selection.Breadth(most=1))
    progress(0.3)
    rebased = problem.rebased(cases)
    if rebased:
        selection.select(problem, rebased, selection.Breadth(most=1))
    missing = [x for x in cases if x.best.members != x.base and not problem.exhausted(x)]
    problem.try_all(_pairs_of_families(problem, missing))
    problem.singles = False
    selection.select(
        problem,
        cases,
        progress=lambda share: progress(0.4 + 0.5 * share),
        exhausted=problem.exhausted,
    )
    # Where the plain servo is most probable no effect is named, and no rival matters.
    going = [x for x in cases if x.best.members != x.base and not problem.exhausted(x)]
    changed = with_rivals(problem, going, joints)
    selection.select(problem, changed, exhausted=problem.exhausted)
    problem.release(cases)
    return cases, problem


def search_again(problem: ServoSearch, cases: Sequence[Tried]) -> None:
    """Try every effect together with the most probable set of each joint, until no set is better.

    For joints whose most probable set leaves structure in the residual: a noise model that has
    taken up structure hides an effect from the linear look that chooses what is tried, and fixed
    nuisances favour the set with which they were fitted.
    """
    some = [tried for tried in cases if not problem.exhausted(tried)]
    problem.resume(some)
    selection.widen(problem, some)
    problem.release(some)


def _pairs_of_families(
    problem: ServoSearch, cases: Sequence[Tried], *, share: float = 0.5
) -> list[Job]:
    """Pairs of effects of one family, each started from the fit of its better member alone."""
    alone: list[tuple[Tried, str, Set]] = []
    for tried in cases:
        least = tried.plain.evidence + share * (tried.best.evidence - tried.plain.evidence)
        families: dict[str, Set] = {}
        for hypothesis in sorted(tried.tried.values(), key=lambda h: h.evidence):
            added = hypothesis.members - tried.base
            if len(added) == 1 and hypothesis.evidence > least and _has_partner(*added):
                families[named(*added).family] = hypothesis.members
        alone += [(tried, family, members) for family, members in families.items()]
    problem.look([(tried, members) for tried, _, members in alone])
    return [
        (tried, members | {name}, start)
        for tried, family, members in alone
        for name, start in problem.additions(tried, members, len(FITTED))
        if named(name).family == family
    ]


def _has_partner(effect: str) -> bool:
    """Whether another effect of the family of this one can be present with it."""
    one = named(effect)
    return any(one.family == e.family != "" and not one.excludes(e) for e in FITTED)
