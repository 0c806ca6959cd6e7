"""Which effects does each joint need? The servo's side of the search of ``inference.selection``.

What every servo has is part of the plain servo, before anything is looked for. A rotor turns with
the load that is stated. Cogging and the sensor's eccentricity are common to all recordings; left
out, their waves pass for any effect. They are fitted together with what explains most, so that they
do not stand in for it, and kept while they are small relative to the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from sim2real.diagnose.baseline import plain_again
from sim2real.diagnose.case import UNMODELLED_INERTIA, JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.gear_trains import try_gear_trains
from sim2real.diagnose.screening import FITTED, NUISANCES, candidate
from sim2real.diagnose.servo_search import Job, ServoSearch, plain_sets
from sim2real.effects import named
from sim2real.effects.servo.sensor_eccentricity import RANGE_RAD
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.inference import selection
from sim2real.inference.normal import Z90
from sim2real.progress import Progress
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT, TRAIN_ROTORS


def search(
    batch: Batch,
    joints: Sequence[JointCase],
    known: Sequence[Tried],
    *,
    level: float,
    rng: np.random.Generator,
    progress: Progress = lambda share: None,
) -> tuple[list[Tried], ServoSearch]:
    """Try sets of effects on every joint until none is better, from what a first look tried.

    ``level`` is the share of joints that miss nothing and may be searched beyond single effects.

    Where all joints are compared with references, nothing is searched.

    Returns:
        What was tried, one a joint, and what may be asked of it further.
    """
    bases = [joint.base for joint in joints]
    cases, best = plain_sets(plain_again(batch, known, bases), bases), [x.best for x in known]
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
    try_gear_trains(problem, cases)
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


def search_freely(
    batch: Batch,
    joints: Sequence[JointCase],
    before: Sequence[Tried],
    *,
    level: float,
    rng: np.random.Generator,
) -> tuple[list[Tried], ServoSearch]:
    """Go on with the sets that were most probable with the noise model of another batch.

    Returns:
        As of ``search``.
    """
    bases = [tried.base for tried in before]
    cases = plain_sets(plain_again(batch, before, bases), bases)
    problem = ServoSearch(batch, level, rng, max(joint.effort for joint in joints))
    problem.singles = False
    if all(joint.references for joint in joints):
        return cases, problem
    problem.try_all(
        [
            (tried, h.members, h.fit.servos.theta[0])
            for tried, old in zip(cases, before, strict=True)
            for h in problem.compared(old)
        ]
    )
    breadth = selection.Breadth(added=3, rivals=2)
    selection.select(problem, cases, breadth, exhausted=problem.exhausted)
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


NAMES = frozenset(e.name for e in NUISANCES)
_BENT = "sensor_eccentricity"
_ROTOR = frozenset({UNMODELLED_INERTIA})
_CALIBRATED = np.linspace(-RANGE_RAD, RANGE_RAD, 161)


def size_in_noise(best: Hypothesis, effect: str, noise_rad: float) -> float:
    """An effect's size: the angle that it turns the servo by, in standard deviations of the noise.

    Of an error of the sensor it is what a straight line leaves of it where sensors are calibrated.
    """
    theta = best.fit.servos.theta[0]
    first = named(effect).parameters[0].name
    size = theta[COLUMNS.index(f"{effect}.{first}")]
    if effect == _BENT:
        period, phase = (theta[COLUMNS.index(f"{effect}.{n}_rad")] for n in ("period", "phase"))
        wave = np.sin(2 * np.pi * _CALIBRATED / max(period, 1e-9) + phase)
        line = np.polynomial.Polynomial.fit(_CALIBRATED, wave, 1)
        size *= float(np.sqrt(2 * np.mean((wave - line(_CALIBRATED)) ** 2)))
    return float(size / (theta[0] if first.endswith("_Nm") else 1.0) / noise_rad)


def first_look(
    problem: ServoSearch, cases: Sequence[Tried], joints: Sequence[JointCase], *, most: int = 4
) -> None:
    """Try what explains each joint best at first sight, with the small nuisances that show with it.

    ``most`` effects are tried, each added to the plain servo.
    """
    problem.look([(tried, tried.base) for tried in cases])
    problem.try_all(
        [
            (tried, tried.base | {name}, start)
            for tried in cases
            for name, start in problem.additions(tried, tried.base, most)
        ]
    )
    first = [(tried, tried.best) for tried in cases if not tried.best.members >= NAMES]
    jobs = _jobs(problem, first)
    refits = iter(problem.refit([job for group in jobs for job in group]))
    for (tried, best), group in zip(first, jobs, strict=True):
        tried.keep(_best(best, [next(refits) for _ in group], _large(joints[tried.case])))


def with_nuisances(
    problem: ServoSearch,
    cases: Sequence[Tried],
    joints: Sequence[JointCase],
    best: Sequence[Hypothesis],
) -> list[Tried]:
    """The cases, each plain servo with the nuisances that are small.

    They are fitted with what explained each joint best before, of these recordings or of such a
    batch.
    """
    large = [_large(joint) for joint in joints]
    small = [_small(h, x) - tried.base for tried, h, x in zip(cases, best, large, strict=True)]
    wanted = [k for k, names in enumerate(small) if names]
    jobs = [
        (cases[k], best[k].members | cases[k].base, np.array(best[k].fit.servos.theta[0]))
        for k in wanted
    ]
    jobs = [
        # Fitted to these recordings, a small one may be a large one after all.
        (cases[k], cases[k].base | (small[k] & _small(h, large[k])), h.fit.servos.theta[0])
        for k, h in zip(wanted, problem.refit(jobs), strict=True)
    ]
    for tried, members, _ in jobs:
        # As fitted together with what explains most, and so they stay.
        problem.fixed[tried.case] = members - tried.base
    based = list(cases)
    for k, (tried, members, _), refitted in zip(wanted, jobs, problem.refit(jobs), strict=True):
        # As part of the base they cost no set their prior.
        evidence = refitted.evidence - len(members - tried.base) * LOG_PRIOR
        based[k] = Tried(tried.case, members, {members: replace(refitted, evidence=evidence)})
    return based


def beyond_likely(best: Hypothesis, joint: JointCase) -> float:
    """Inertia in kg m2 by which a load is stated too small for any likely rotor, or too large.

    The rotor of a gear train counts. Recordings hardly tell how large it is, and a stated load may
    include it.
    """
    first, second = best.fit.servos.theta[0, list(TRAIN_ROTORS)]
    rotor, room = float(first or second), joint.rotor_room_kgm2
    beyond = float(best.fit.servos.theta[0, INERTIA_LEFT_OUT]) + rotor
    return max(beyond - room, -beyond - (room if rotor else 0.0), 0.0)


def states_load(best: Hypothesis, joint: JointCase) -> bool:
    """Whether the load may be stated right, by what a set says of inertia beside it."""
    servos = best.fit.servos
    place = servos.columns[0] == INERTIA_LEFT_OUT
    sd = float(np.sum(np.sqrt(best.fit.variances[place]) * servos.unit[0, place]))
    small = DECISION.inertia_tolerance * joint.traces[0].load.inertia_kgm2
    return beyond_likely(best, joint) - Z90 * sd < small


def with_rotors(
    problem: ServoSearch, cases: Sequence[Tried], joints: Sequence[JointCase]
) -> list[Tried]:
    """The cases, each plain servo with its rotor where the recordings show one.

    Every servo has one, and stated loads leave it out: an inertia that the data sheet makes likely
    costs no set its prior.
    """
    based, jobs, places = list(cases), list[Job](), list[int]()
    for k, (tried, joint) in enumerate(zip(cases, joints, strict=True)):
        if joint.rotor_room_kgm2 == 0 or tried.base >= _ROTOR:
            continue
        turning = Tried(tried.case, tried.base | _ROTOR)
        others = tried.plain.evidence + DECISION.nuisance_min_evidence
        for h in tried.tried.values():
            if h.members >= _ROTOR and states_load(h, joint):
                turning.keep(replace(h, evidence=h.evidence - LOG_PRIOR))
            else:
                others = max(others, h.evidence)
        if turning.tried and turning.best.evidence > others:
            based[k] = turning
            jobs.append((tried, turning.base, turning.best.fit.servos.theta[0]))
            places.append(k)
    for k, plain in zip(places, problem.refit(jobs), strict=True):
        based[k].keep(replace(plain, evidence=plain.evidence - LOG_PRIOR))
        if not states_load(based[k].plain, joints[k]):
            based[k] = cases[k]  # no rotor by itself
    return based


def with_rivals(
    problem: ServoSearch,
    cases: Sequence[Tried],
    joints: Sequence[JointCase],
    *,
    rivals: int = 8,
    promise: float = 2.0,
) -> list[Tried]:
    """Try small nuisances with the most probable sets of each joint as well.

    One that was not seen with the first explanation speaks for what happens to be shaped like it.
    A fit may make ``promise`` times the gain at first sight.

    Returns:
        Those in which other effects are most probable now.
    """
    before = {tried.case: tried.best for tried in cases}
    pairs = [
        (tried, h)
        for tried in cases
        for h in sorted(tried.tried.values(), key=lambda h: -h.evidence)[:rivals]
        if not h.members >= NAMES and h.evidence > before[tried.case].evidence - problem.limits.near
    ]
    behind = [before[tried.case].evidence - h.evidence for tried, h in pairs]
    jobs = _jobs(problem, pairs, [max(x / promise, DECISION.nuisance_min_evidence) for x in behind])
    refits = iter(problem.refit([job for group in jobs for job in group]))
    for (tried, h), group in zip(pairs, jobs, strict=True):
        found = [next(refits) for _ in group]
        if not found:
            continue
        large = _large(joints[tried.case])
        tried.keep(_best(h, found, large))
        # Bent more than any sensor that is in order: no nuisance, and it has no name.
        bent = [t for t in found if _BENT in t.members - _small(t, large)]
        top = max(bent, key=lambda t: t.evidence, default=h)
        if top.evidence > before[tried.case].evidence + DECISION.decisive_gain:
            tried.keep(top)
    return [t for t in cases if t.best.members - NAMES != before[t.case].members - NAMES]


def _jobs(
    problem: ServoSearch,
    pairs: Sequence[tuple[Tried, Hypothesis]],
    worth: Sequence[float] | None = None,
    *,
    starts_each: int = 2,
) -> list[list[Job]]:
    """For each hypothesis every set of nuisances added to it, from the most probable waves."""
    lists = [
        [candidate(named(n), *problem.strength(tried)) for n in sorted(NAMES - h.members)]
        for tried, h in pairs
    ]
    jobs: list[list[Job]] = [[] for _ in pairs]
    for n, (options, seen) in enumerate(zip(lists, problem.screened(pairs, lists), strict=True)):
        tried, base = pairs[n]
        starts: dict[str, list[np.ndarray]] = {}
        for k, option in enumerate(options):
            mine = np.flatnonzero(seen.candidate == k)
            best = mine[np.argsort(-seen.gain[mine])][:starts_each]
            if worth is None or seen.gain[best[0]] > worth[n]:
                starts[option.effect.name] = [option.starts[seen.start[i]] for i in best]
        columns = {option.effect.name: option.columns for option in options}
        for count in range(1, len(starts) + 1):
            for names in combinations(starts, count):
                for turn in range(starts_each):
                    theta = np.array(base.fit.servos.theta[0])
                    for name in names:
                        theta[columns[name]] = starts[name][min(turn, len(starts[name]) - 1)]
                    jobs[n].append((tried, base.members | set(names), theta))
    return jobs


def _best(first: Hypothesis, tried: Sequence[Hypothesis], large_rad: float) -> Hypothesis:
    """The best set with those nuisances that are small where all are tried, if worth it."""
    top = max(tried, key=lambda h: h.evidence)
    # Where a large wave is most probable, a small one in its place only stands in for it.
    small = first.members | _small(top, large_rad)
    sets = [h for h in tried if h.members <= small and _small(h, large_rad) >= h.members & NAMES]
    best = max([first, *sets], key=lambda h: h.evidence)
    return best if best.evidence > first.evidence + DECISION.nuisance_min_evidence else first


def _large(joint: JointCase) -> float:
    """Angle from which a joint's nuisance is a finding, rad."""
    return DECISION.nuisance_finding_size * joint.noise


def _small(hypothesis: Hypothesis, large_rad: float) -> Set:
    """Those of its nuisances that are small."""
    names = NAMES & hypothesis.members
    return frozenset(name for name in names if size_in_noise(hypothesis, name, large_rad) < 1)
