"""What every servo has: part of the plain servo, before anything is looked for.

A rotor turns with the load that is stated. Cogging and the sensor's eccentricity are common to all
recordings, and small ones need no action. Left out, their waves pass for any effect. They are
fitted together with what explains most, so that they do not stand in for it, and kept while they
are small relative to the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from sim2real.diagnose.case import UNMODELLED_INERTIA, JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.missing.screening import NUISANCES, candidate
from sim2real.diagnose.missing.servo_search import Job, ServoSearch
from sim2real.effects import named
from sim2real.effects.servo.sensor_eccentricity import RANGE_RAD
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.inference.normal import Z90
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT, TRAIN_ROTORS

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
    problem: ServoSearch, ledgers: Sequence[Tried], large: Sequence[float], *, most: int = 4
) -> None:
    """Try what explains each joint best at first sight, with the small nuisances that show with it.

    Args:
        problem: The search to come.
        ledgers: One a joint, of plain servos.
        large: Angle from which a joint's nuisance is a finding, rad.
        most: Effects that are tried, each added to the plain servo.
    """
    problem.look([(ledger, ledger.base) for ledger in ledgers])
    jobs = [
        (ledger, ledger.base | {name}, start)
        for ledger in ledgers
        for name, start in problem.additions(ledger, ledger.base, most)
    ]
    for (ledger, _, _), refitted in zip(jobs, problem.refit(jobs), strict=True):
        ledger.keep(refitted)
    first = {ledger.case: ledger.best for ledger in ledgers}
    wanted = [ledger for ledger in ledgers if _missing(first[ledger.case].members)]
    if not wanted:
        return
    pairs = [(ledger, first[ledger.case]) for ledger in wanted]
    jobs = [job for group in _jobs(problem, pairs) for job in group]
    tried: dict[int, list[Hypothesis]] = {ledger.case: [] for ledger in wanted}
    for (ledger, _, _), refitted in zip(jobs, problem.refit(jobs), strict=True):
        tried[ledger.case].append(refitted)
    for ledger in wanted:
        ledger.keep(_best(first[ledger.case], tried[ledger.case], large[ledger.case]))


def with_nuisances(
    problem: ServoSearch,
    ledgers: Sequence[Tried],
    large: Sequence[float],
    best: Sequence[Hypothesis],
) -> list[Tried]:
    """The ledgers, each plain servo with the nuisances that are small.

    Args:
        problem: The search to come.
        ledgers: One a joint, of plain servos.
        large: Angle from which a joint's nuisance is a finding, rad.
        best: What explained each best before, of these recordings or of such a batch: the nuisances
            are fitted with it.
    """
    small = [
        _small(h, angle) - ledger.base
        for ledger, h, angle in zip(ledgers, best, large, strict=True)
    ]
    wanted = [k for k, names in enumerate(small) if names]
    if not wanted:
        return list(ledgers)
    jobs = [
        (ledgers[k], best[k].members | ledgers[k].base, np.array(best[k].fit.servos.theta[0]))
        for k in wanted
    ]
    refits = problem.refit(jobs)
    jobs = [
        # Fitted to these recordings, a small one may be a large one after all.
        (ledgers[k], ledgers[k].base | (small[k] & _small(h, large[k])), h.fit.servos.theta[0])
        for k, h in zip(wanted, refits, strict=True)
    ]
    for ledger, members, _ in jobs:
        # As fitted together with what explains most, and so they stay.
        problem.held[ledger.case] = members - ledger.base
    based = list(ledgers)
    for k, (ledger, members, _), refitted in zip(wanted, jobs, problem.refit(jobs), strict=True):
        based[k] = Tried(ledger.case, members)
        # As part of the base they cost no set their prior.
        evidence = refitted.evidence - len(members - ledger.base) * LOG_PRIOR
        based[k].keep(replace(refitted, evidence=evidence))
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
    problem: ServoSearch, ledgers: Sequence[Tried], joints: Sequence[JointCase]
) -> list[Tried]:
    """The ledgers, each plain servo with its rotor where the recordings show one.

    Every servo has one, and stated loads leave it out: an inertia that the data sheet makes likely
    costs no set its prior.

    Args:
        problem: The search that was.
        ledgers: What it tried.
        joints: The joints.
    """
    based, jobs, places = list(ledgers), list[Job](), list[int]()
    for k, (ledger, joint) in enumerate(zip(ledgers, joints, strict=True)):
        if joint.rotor_room_kgm2 == 0 or ledger.base >= _ROTOR:
            continue
        turning = Tried(ledger.case, ledger.base | _ROTOR)
        others = ledger.plain.evidence + DECISION.nuisance_min_evidence
        for h in ledger.tried.values():
            if h.members >= _ROTOR and states_load(h, joint):
                turning.keep(replace(h, evidence=h.evidence - LOG_PRIOR))
            else:
                others = max(others, h.evidence)
        if turning.tried and turning.best.evidence > others:
            based[k] = turning
            jobs.append((ledger, turning.base, turning.best.fit.servos.theta[0]))
            places.append(k)
    for k, plain in zip(places, problem.refit(jobs), strict=True):
        based[k].keep(replace(plain, evidence=plain.evidence - LOG_PRIOR))
        if not states_load(based[k].plain, joints[k]):
            based[k] = ledgers[k]  # no rotor by itself
    return based


def with_rivals(
    problem: ServoSearch,
    ledgers: Sequence[Tried],
    large: Sequence[float],
    *,
    rivals: int = 8,
    promise: float = 2.0,
) -> list[Tried]:
    """Try small nuisances with the likeliest sets of each joint as well.

    One that was not seen with the first explanation speaks for what happens to be shaped like it.

    Args:
        problem: The search that was.
        ledgers: What it tried.
        large: Angle from which a joint's nuisance is a finding, rad.
        rivals: Sets of effects of each joint that are looked at.
        promise: Times the gain at first sight that a fit may make.

    Returns:
        Those in which other effects are likeliest now.
    """
    before = {ledger.case: ledger.best for ledger in ledgers}
    largest = {ledger.case: angle for ledger, angle in zip(ledgers, large, strict=True)}
    within = problem.limits.near
    pairs = [
        (ledger, h)
        for ledger in ledgers
        for h in sorted(ledger.tried.values(), key=lambda h: -h.evidence)[:rivals]
        if _missing(h.members) and h.evidence > before[ledger.case].evidence - within
    ]
    behind = [before[ledger.case].evidence - h.evidence for ledger, h in pairs]
    jobs = _jobs(problem, pairs, [max(x / promise, DECISION.nuisance_min_evidence) for x in behind])
    refits = iter(problem.refit([job for group in jobs for job in group]))
    for (ledger, h), group in zip(pairs, jobs, strict=True):
        tried = [next(refits) for _ in group]
        if not tried:
            continue
        ledger.keep(_best(h, tried, largest[ledger.case]))
        # Bent more than any sensor that is in order: no nuisance, and it has no name.
        bent = [t for t in tried if _BENT in t.members - _small(t, largest[ledger.case])]
        top = max(bent, key=lambda t: t.evidence, default=h)
        if top.evidence > before[ledger.case].evidence + DECISION.decisive_gain:
            ledger.keep(top)
    return [
        ledger
        for ledger in ledgers
        if ledger.best.members - NAMES != before[ledger.case].members - NAMES
    ]


def _missing(members: Set) -> list[str]:
    return sorted(NAMES - members)


def _jobs(
    problem: ServoSearch,
    pairs: Sequence[tuple[Tried, Hypothesis]],
    worth: Sequence[float] | None = None,
    *,
    starts_each: int = 2,
) -> list[list[Job]]:
    """For each hypothesis every set of nuisances added to it, from the likeliest waves."""
    lists = [
        [candidate(named(n), *problem.strength(ledger)) for n in _missing(h.members)]
        for ledger, h in pairs
    ]
    jobs: list[list[Job]] = [[] for _ in pairs]
    for n, (options, seen) in enumerate(zip(lists, problem.screened(pairs, lists), strict=True)):
        ledger, base = pairs[n]
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
                    jobs[n].append((ledger, base.members | set(names), theta))
    return jobs


def _best(first: Hypothesis, tried: Sequence[Hypothesis], large_rad: float) -> Hypothesis:
    """The likeliest set with those nuisances that are small where all are tried, if worth it."""
    top = max(tried, key=lambda h: h.evidence)
    # Where a large wave is likeliest, a small one in its place only stands in for it.
    small = first.members | _small(top, large_rad)
    sets = [h for h in tried if h.members <= small and _small(h, large_rad) >= h.members & NAMES]
    best = max([first, *sets], key=lambda h: h.evidence)
    return best if best.evidence > first.evidence + DECISION.nuisance_min_evidence else first


def _small(hypothesis: Hypothesis, large_rad: float) -> Set:
    """Those of its nuisances that are small."""
    names = NAMES & hypothesis.members
    return frozenset(name for name in names if size_in_noise(hypothesis, name, large_rad) < 1)
