"""Which effects does each joint need? The servo's side of the search of ``inference.selection``.

What every servo has is part of the plain servo: a rotor, and cogging and the sensor's eccentricity
while they are small. Left out, their waves pass for any effect; so they are fitted together with
what explains most.
"""

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


def search(
    batch: Batch,
    joints: Sequence[JointCase],
    known: Sequence[Tried],
    level: float,
    rng: np.random.Generator,
    *,
    again: bool = False,
    progress: Progress = lambda share: None,
) -> tuple[list[Tried], ServoSearch]:
    """What was tried on every joint until no set of effects is better, and what may be asked of it.

    ``level`` is the share of joints that miss nothing and may be searched beyond single effects.
    Without ``again`` what is known is a first look at such a batch. With it, it is a whole search
    with another noise model: its nuisances and its most probable sets are tried, and few besides.
    Where all joints are compared with references, nothing is searched.
    """
    cases = plain_sets(plain_again(batch, known), [x.base for x in known])
    problem = ServoSearch(batch, joints, level, rng)
    if all(joint.references for joint in joints):
        return cases, problem
    if not again:
        cases = with_nuisances(problem, cases, [x.best for x in known])
    jobs: list[Job] = []
    for tried, before, joint in zip(cases, known, joints, strict=True):
        sets = problem.compared(before) if again else [before.best]
        rows = [(h.members, h.fit.servos.theta[0]) for h in sets if not h.members <= tried.base]
        rows += [] if again else joint.stated
        jobs += [(tried, tried.base | members, theta) for members, theta in rows]
    problem.try_all(jobs)
    if not again:
        selection.select(problem, cases, selection.Breadth(most=1), progress)
        try_gear_trains(problem, cases)
    problem.singles = False
    breadth = selection.Breadth(added=3, rivals=2) if again else selection.Breadth()
    selection.select(problem, cases, breadth, progress, problem.exhausted)
    if not again:
        # Where the plain servo is most probable no effect is named, and no rival matters.
        going = [x for x in cases if x.best.members != x.base and not problem.exhausted(x)]
        selection.select(problem, with_rivals(problem, going), exhausted=problem.exhausted)
        problem.release(cases)
    return cases, problem


def search_again(problem: ServoSearch, cases: Sequence[Tried]) -> None:
    """Try every effect with the most probable set of each joint, until no set is better."""
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
        angles = np.linspace(-RANGE_RAD, RANGE_RAD, 161)
        wave = np.sin(2 * np.pi * angles / max(period, 1e-9) + phase)
        line = np.polynomial.Polynomial.fit(angles, wave, 1)
        size *= float(np.sqrt(2 * np.mean((wave - line(angles)) ** 2)))
    return float(size / (theta[0] if first.endswith("_Nm") else 1.0) / noise_rad)


def first_look(problem: ServoSearch, cases: Sequence[Tried], *, most: int = 4) -> None:
    """Try the effects that explain each joint best at first sight, and small nuisances besides."""
    problem.look([(tried, tried.base) for tried in cases])
    jobs: list[Job] = []
    for tried in cases:
        starts = problem.additions(tried, tried.base, most)
        jobs += [(tried, tried.base | {name}, start) for name, start in starts]
    problem.try_all(jobs)
    for tried in cases:
        found = _waved(problem, tried, tried.best)
        if found:
            tried.keep(_best(tried.best, found, _large(problem, tried)))


def _waved(
    problem: ServoSearch,
    tried: Tried,
    base: Hypothesis,
    least_gain: float = -np.inf,
    *,
    starts: int = 2,
) -> list[Hypothesis]:
    """A hypothesis with every set of nuisances that gain more than this at first sight."""
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
    problem: ServoSearch, cases: Sequence[Tried], best: Sequence[Hypothesis]
) -> list[Tried]:
    """The cases, each plain servo with small nuisances, as fitted with what was best before."""
    based = list(cases)
    for k, (tried, known) in enumerate(zip(cases, best, strict=True)):
        large = _large(problem, tried)
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


def states_load(best: Hypothesis, joint: JointCase) -> bool:
    """Whether the load may be stated right, by what a set says of inertia beside it.

    A rotor that the data sheet makes likely may add to it, that of a gear train included: how large
    it is recordings hardly tell, and a stated load may include it.
    """
    servos, room = best.fit.servos, joint.rotor_room_kgm2
    first, second = servos.theta[0, list(TRAIN_ROTORS)]
    rotor = float(first or second)
    left_out = float(servos.theta[0, INERTIA_LEFT_OUT]) + rotor
    beyond = max(left_out - room, -left_out - (room if rotor else 0.0), 0.0)
    place = servos.columns[0] == INERTIA_LEFT_OUT
    sd = float(np.sum(np.sqrt(best.fit.variances[place]) * servos.unit[0, place]))
    return beyond - Z90 * sd < DECISION.inertia_tolerance * joint.traces[0].load.inertia_kgm2


def with_rotors(problem: ServoSearch, cases: Sequence[Tried]) -> list[Tried]:
    """The cases, each plain servo with its rotor where the recordings show one.

    Every servo has one, and stated loads leave it out: an inertia that the data sheet makes likely
    costs no set its prior.
    """
    based = list(cases)
    for k, tried in enumerate(cases):
        joint = problem.joints[tried.case]
        if joint.rotor_room_kgm2 == 0 or UNMODELLED_INERTIA in tried.base:
            continue
        turning = Tried(tried.case, tried.base | {UNMODELLED_INERTIA})
        others = tried.plain.evidence + DECISION.nuisance_min_evidence
        for h in tried.tried.values():
            if UNMODELLED_INERTIA in h.members and states_load(h, joint):
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
    problem: ServoSearch, cases: Sequence[Tried], *, rivals: int = 8, promise: float = 2.0
) -> list[Tried]:
    """Those joints in which, with small nuisances tried too, other effects are most probable now.

    One that was not seen with the first explanation speaks for what happens to be shaped like it.
    A fit may make ``promise`` times the gain at first sight.
    """
    changed = []
    for tried in cases:
        before, large = tried.best, _large(problem, tried)
        near = sorted(tried.tried.values(), key=lambda h: -h.evidence)[:rivals]
        for h in near:
            behind = before.evidence - h.evidence
            worth = max(behind / promise, DECISION.nuisance_min_evidence)
            found = _waved(problem, tried, h, worth) if behind < problem.near else []
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


def _large(problem: ServoSearch, tried: Tried) -> float:
    """Angle from which a joint's nuisance is a finding, rad."""
    return DECISION.nuisance_finding_size * problem.joints[tried.case].noise


def _small(hypothesis: Hypothesis, large_rad: float) -> Set:
    """Those of its nuisances that are small."""
    names = NAMES & hypothesis.members
    return frozenset(name for name in names if size_in_noise(hypothesis, name, large_rad) < 1)
