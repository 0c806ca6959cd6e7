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

from sim2real.diagnose.case import UNMODELLED_INERTIA, JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.gear_trains import try_gear_trains
from sim2real.diagnose.screening import NUISANCES, candidate
from sim2real.diagnose.servo_search import Job, ServoSearch, plain_again, plain_sets
from sim2real.effects import named
from sim2real.effects.servo.sensor_eccentricity import RANGE_RAD
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.inference import selection
from sim2real.inference.normal import Z90
from sim2real.progress import Progress
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT, TRAIN_ROTORS

NAMES = frozenset(e.name for e in NUISANCES)
_BENT = "sensor_eccentricity"
_ROTOR = frozenset({UNMODELLED_INERTIA})
_CALIBRATED = np.linspace(-RANGE_RAD, RANGE_RAD, 161)


def search(
    batch: Batch,
    joints: Sequence[JointCase],
    known: Sequence[Tried],
    *,
    level: float,
    rng: np.random.Generator,
    again: bool = False,
    progress: Progress = lambda share: None,
) -> tuple[list[Tried], ServoSearch]:
    """Try sets of effects on every joint until none is better, from what was tried before.

    ``level`` is the share of joints that miss nothing and may be searched beyond single effects.
    Without ``again`` what is known is a first look at such a batch. With it, it is a whole search
    with another noise model: its nuisances and its most probable sets are tried, and few besides.

    Where all joints are compared with references, nothing is searched.

    Returns:
        What was tried, one a joint, and what may be asked of it further.
    """
    cases = plain_sets(plain_again(batch, known), [x.base for x in known])
    problem = ServoSearch(batch, level, rng, max(joint.effort for joint in joints))
    if all(joint.references for joint in joints):
        return cases, problem
    if not again:
        cases = with_nuisances(problem, cases, joints, [x.best for x in known])
    jobs: list[Job] = []
    for tried, before, joint in zip(cases, known, joints, strict=True):
        sets = problem.compared(before) if again else [before.best]
        rows = [(h.members, h.fit.servos.theta[0]) for h in sets if not h.members <= tried.base]
        rows += [] if again else joint.stated
        jobs += [(tried, tried.base | members, theta) for members, theta in rows]
    problem.try_all(jobs)
    problem.singles = not again
    if not again:
        selection.select(problem, cases, selection.Breadth(most=1), progress)
        try_gear_trains(problem, cases)
        problem.singles = False
    breadth = selection.Breadth(added=3, rivals=2) if again else selection.Breadth()
    selection.select(problem, cases, breadth, progress, problem.exhausted)
    if not again:
        # Where the plain servo is most probable no effect is named, and no rival matters.
        going = [x for x in cases if x.best.members != x.base and not problem.exhausted(x)]
        changed = with_rivals(problem, going, [joints[x.case] for x in going])
        selection.select(problem, changed, exhausted=problem.exhausted)
        problem.release(cases)
    return cases, problem


def search_again(problem: ServoSearch, cases: Sequence[Tried]) -> None:
    """Try every effect together with the most probable set of each joint, until no set is better.

    For joints whose most probable set leaves structure in the residual: a noise model that has
    taken up structure hides an effect from the linear look that chooses what is tried.
    """
    some = [tried for tried in cases if not problem.exhausted(tried)]
    problem.singles = True
    selection.widen(problem, some)
    problem.release(some)


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
    for tried, joint in zip(cases, joints, strict=True):
        found = _waved(problem, tried, tried.best)
        if found:
            tried.keep(_best(tried.best, found, _large(joint)))


def _waved(
    problem: ServoSearch,
    tried: Tried,
    base: Hypothesis,
    least_gain: float = -np.inf,
    *,
    starts: int = 2,
) -> list[Hypothesis]:
    """Every set of nuisances added to a hypothesis, from the most probable waves.

    Only nuisances whose gain at first sight is more than ``least_gain``.
    """
    names = sorted(NAMES - base.members)
    if not names or problem.batch.slow is not None:  # slow errors are noise already
        return []
    options = [candidate(named(name), *problem.strength(tried)) for name in names]
    (seen,) = problem.screened([(tried, base)], [options])
    waves = {}
    for k, option in enumerate(options):
        mine = np.flatnonzero(seen.candidate == k)
        best = mine[np.argsort(-seen.gain[mine])][:starts]
        if seen.gain[best[0]] > least_gain:
            waves[k] = [option.starts[i] for i in np.resize(seen.start[best], starts)]
    jobs: list[Job] = []
    for count in range(1, len(waves) + 1):
        for some in combinations(waves, count):
            for turn in range(starts):
                theta = np.array(base.fit.servos.theta[0])
                for k in some:
                    theta[options[k].columns] = waves[k][turn]
                jobs.append((tried, base.members | {names[k] for k in some}, theta))
    return problem.refit(jobs)


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
    based = list(cases)
    for k, (tried, known, joint) in enumerate(zip(cases, best, joints, strict=True)):
        large = _large(joint)
        small = _small(known, large) - tried.base
        if not small:
            continue
        # Fitted to these recordings, a small one may be a large one after all.
        theta = known.fit.servos.theta[0]
        (whole,) = problem.refit([(tried, known.members | tried.base, theta)])
        members = tried.base | (small & _small(whole, large))
        # As fitted together with what explains most, and so they stay.
        problem.fixed[tried.case] = members - tried.base
        (plain,) = problem.refit([(tried, members, whole.fit.servos.theta[0])])
        # As part of the base they cost no set their prior.
        evidence = plain.evidence - len(members - tried.base) * LOG_PRIOR
        based[k] = Tried(tried.case, members, {members: replace(plain, evidence=evidence)})
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
    based = list(cases)
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
        if not turning.tried or turning.best.evidence <= others:
            continue
        job = tried, turning.base, turning.best.fit.servos.theta[0]
        for plain in problem.refit([job], free=True):
            turning.keep(replace(plain, evidence=plain.evidence - LOG_PRIOR))
        if states_load(turning.plain, joint):  # else it is no rotor by itself
            based[k] = turning
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
    changed = []
    for tried, joint in zip(cases, joints, strict=True):
        before, large = tried.best, _large(joint)
        near = sorted(tried.tried.values(), key=lambda h: -h.evidence)[:rivals]
        for h in near:
            behind = before.evidence - h.evidence
            if behind >= problem.limits.near:
                continue
            worth = max(behind / promise, DECISION.nuisance_min_evidence)
            found = _waved(problem, tried, h, worth)
            if not found:
                continue
            tried.keep(_best(h, found, large))
            # Bent more than any sensor that is in order: no nuisance, and it has no name.
            bent = [t for t in found if _BENT in t.members - _small(t, large)]
            top = max(bent, key=lambda t: t.evidence, default=h)
            if top.evidence > before.evidence + DECISION.decisive_gain:
                tried.keep(top)
        if tried.best.members - NAMES != before.members - NAMES:
            changed.append(tried)
    return changed


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
