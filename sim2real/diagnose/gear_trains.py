"""Gear trains of two masses, which a linear look at one start of each effect misses.

Their fits have branches: the controller on either side, dry friction on either side, a light rotor
or a heavy one. From the plain servo and from the set that explains a joint best without dry
friction and gears, both also with Coulomb friction, many starts are compared at their full
strength, and the best of each branch are fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import UNMODELLED_INERTIA
from sim2real.diagnose.free_parameters import BRANCHES
from sim2real.diagnose.screening import Candidate, Screen, candidate, may_join
from sim2real.diagnose.servo_search import Job, ServoSearch
from sim2real.effects import named
from sim2real.effects.effect import Effect
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.servo.parameters import (
    CONTROL_SIDE,
    FIRST_COLUMN,
    INERTIA_LEFT_OUT,
    TRAIN_ROTORS,
    TRAINS,
)

_COULOMB = "coulomb_friction"
_OUTPUT_FRICTION = "output_friction_Nm"
_STARTS = {
    "gap_rad": (0.15, 0.3, 0.6, 1.2, 2.4),
    "compliance_rad_per_Nm": (0.3, 1.0, 3.0, 10.0),
    "rotor_inertia_kgm2": (0.5, 1.2, 3.0),
    _OUTPUT_FRICTION: (0.0, 1.0),
    CONTROL_SIDE: (0.0, 1.0),
    "sensor_on_output": (0.0, 1.0),
    "restitution": (0.0, 1.0),
    "damping_ratio": (1.0, 4.0),
}
"""Starting values in typical values; friction on the output in that of the best fit."""


def try_gear_trains(problem: ServoSearch, cases: Sequence[Tried]) -> None:
    """Try gear trains on joints that rub or have one, or whose best set leaves something."""
    some = [
        tried
        for tried in cases
        if tried.best.members != tried.base
        and not problem.exhausted(tried)
        and (_of_gears(tried.best) or problem.remains(tried, tried.best.members))
    ]
    places = list(_places(problem, some))
    lists = [
        [_with_starts(problem, tried, name) for name in TRAINS if may_join(named(name), h.members)]
        for tried, h in places
    ]
    places, lists = _kept(places, lists)
    jobs: list[Job] = []
    for (tried, h), options, seen in zip(
        places, lists, problem.screened(places, lists), strict=True
    ):
        for k, option in enumerate(options):
            for start in _best_of_branches(option, seen, k):
                theta = h.fit.servos.theta[0].copy()
                theta[option.columns] = start
                jobs.append((tried, h.members | {option.effect.name}, theta))
    before = problem.batch.substeps.copy()
    problem.try_all(jobs)
    problem.try_all(list(_whole_inertias(some)))
    problem.spent_before += problem.batch.substeps - before  # not of the search's budget


def _full_gain(seen: Screen) -> Array:
    """Gains in log-likelihood by starts as they are, not by their best strength, shape (S,)."""
    return np.asarray(seen.score * seen.visible - 0.5 * seen.visible**2)


def _whole_inertias(some: Sequence[Tried]) -> Iterator[Job]:
    """The best of each gear train, with a stated load that includes the rotor."""
    for tried in some:
        for name, rotor in zip(TRAINS, TRAIN_ROTORS, strict=True):
            found = [h for h in tried.tried.values() if name in h.members]
            best = max(found, key=lambda h: h.evidence, default=None)
            if best is not None and UNMODELLED_INERTIA not in best.members:
                theta = best.fit.servos.theta[0].copy()
                theta[INERTIA_LEFT_OUT] -= theta[rotor]
                yield tried, best.members | {UNMODELLED_INERTIA}, theta


def _kept(
    places: list[tuple[Tried, Hypothesis]], lists: list[list[Candidate]]
) -> tuple[list[tuple[Tried, Hypothesis]], list[list[Candidate]]]:
    """Places at which there is something to try."""
    some = [k for k, options in enumerate(lists) if options]
    return [places[k] for k in some], [lists[k] for k in some]


def _of_gears(best: Hypothesis) -> Set:
    """Effects of a set that are dry friction or a gear train."""
    dry = named(_COULOMB).family
    return frozenset(e for e in best.members if named(e).family == dry or e in TRAINS)


def _friction_Nm(best: Hypothesis) -> float:
    """Largest torque of a set's dry friction, 0 without."""
    row = best.fit.servos.theta[0]
    torques = [
        float(row[FIRST_COLUMN[effect] + k])
        for effect in _of_gears(best)
        for k, parameter in enumerate(named(effect).parameters)
        if parameter.name in ("torque_Nm", "breakaway_Nm", _OUTPUT_FRICTION)
    ]
    return max(torques, default=0.0)


def _places(problem: ServoSearch, some: Sequence[Tried]) -> Iterator[tuple[Tried, Hypothesis]]:
    """The plain servo, and the best set without friction and gears; both with Coulomb friction too.

    What else explains a joint may only imitate a gap, as a dead band does.
    """
    jobs: list[Job] = []
    for tried in some:
        best, friction = tried.best, _friction_Nm(tried.best)
        # each once, and in an order that does not depend on the hashes of names
        for smooth in dict.fromkeys((tried.base, best.members - _of_gears(best))):
            row = best.fit.servos.theta[0].copy()
            jobs.append((tried, smooth, row))
            row = row.copy()
            row[FIRST_COLUMN[_COULOMB]] = friction
            if friction > 0:
                jobs.append((tried, smooth | {_COULOMB}, row))
    problem.try_all([job for job in jobs if job[1] not in job[0].tried])
    for tried, members, _ in jobs:
        yield tried, tried.tried[members]


def _with_starts(problem: ServoSearch, tried: Tried, name: str) -> Candidate:
    """A gear train with all its starts, scaled to a servo."""
    effect: Effect = named(name)
    wide = replace(
        effect, parameters=tuple(replace(p, starts=_STARTS[p.name]) for p in effect.parameters)
    )
    option = candidate(wide, *problem.strength(tried))
    names = [p.name for p in effect.parameters]
    if _OUTPUT_FRICTION in names and (friction := _friction_Nm(tried.best)) > 0:
        place = names.index(_OUTPUT_FRICTION)
        option.starts[option.starts[:, place] > 0, place] = friction
    return option


def _best_of_branches(option: Candidate, seen: Screen, k: int) -> Iterator[Array]:
    """Starts of the k-th candidate that fit best at their full strength, of each branch."""
    mine = np.flatnonzero(seen.candidate == k)
    full = _full_gain(seen)[mine]
    starts = option.starts[seen.start[mine]]
    names = (*BRANCHES, "gap_rad")
    of = np.stack([option.of(name, seen.start[mine]) for name in names], axis=1)
    for branch in np.unique(of, axis=0):
        here = np.flatnonzero((of == branch).all(axis=1))
        yield starts[here[full[here].argmax()]]
