"""Gear trains of two masses, which a linear look at one start of each effect misses.

Their fits have many minima: the controller and dry friction on either side, and contacts whose
order depends on gap, rotor and rebounds. A rotor that is part of the inertia of a servo leaves the
motion of the whole as it was, so many starts are compared at full strength with a fit without gear
train. The best of each branch are fitted, and then starts around what fits best.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import UNMODELLED_INERTIA
from sim2real.diagnose.screening import NUISANCES, Candidate, candidate, may_join
from sim2real.diagnose.servo_search import Job, ServoSearch
from sim2real.effects import named
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.inference.parameters import kronecker
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    CONTROL_SIDE,
    FIRST_COLUMN,
    INERTIA_LEFT_OUT,
    TRAIN_ROTORS,
    TRAINS,
)
from sim2real.units import unit_of

_COULOMB = "coulomb_friction"
_RUB, _SPRING = FIRST_COLUMN[_COULOMB], FIRST_COLUMN["compliance"]
_OUTPUT_FRICTION = "output_friction_Nm"
_STARTS = {
    "gap_rad": (0.15, 0.25, 0.4, 0.65, 1.1, 1.8, 3.0),
    "compliance_rad_per_Nm": (0.3, 1.0, 3.0, 10.0),
    "rotor_inertia_kgm2": (0.2, 0.4, 0.8, 1.4, 2.4),
    _OUTPUT_FRICTION: (0.0, 0.5, 1.0),
    CONTROL_SIDE: (0.0, 0.5, 1.0),
    "sensor_on_output": (0.0, 1.0),
    "restitution": (0.0, 0.8, 1.2, 1.6),
    "damping_ratio": (1.0, 4.0),
}
"""Starting values in typical values; friction on the output in that of the fit without a train."""
_WAVES = [FIRST_COLUMN[effect.name] for effect in NUISANCES]
"""Columns of the sizes of waves that every servo has; fitted without a train, they imitate it."""
_WIDTHS = 0.7, 0.35, 0.35, 0.15
"""Logarithms of the largest factors by which starts around a fit differ from it."""
_SCALES = [
    k
    for k, name in enumerate(COLUMNS)
    if k < 2
    or k in TRAIN_ROTORS
    or (k >= len(BASE) and unit_of(name.partition(".")[2]).startswith("N m"))
]
"""Columns of gains, torques and rotors, which are in proportion to the inertia."""


def try_gear_trains(problem: ServoSearch, cases: Sequence[Tried]) -> None:
    """Try gear trains on joints that rub or have one, or whose best set leaves something."""
    some = [
        tried
        for tried in cases
        if tried.best.members != tried.base
        and not problem.exhausted(tried)
        and (_of_gears(tried.best) or problem.remains(tried, tried.best.members))
    ]
    before = problem.batch.substeps.copy()
    places = [
        (tried, h, [_grid(problem, tried, h, x) for x in TRAINS if may_join(named(x), h.members)])
        for tried, h in _places(problem, some)
    ]
    _follow(problem, places)
    for width in _WIDTHS:
        near = [(x, h) for x in some for h in _with_train(x)]
        near = [(x, h) for x, h in near if h.evidence > x.best.evidence - problem.near]
        _follow(problem, [(*one, [_around(problem, *one, width)]) for one in near])
    # The rotor in addition to the stated load moves the same where neither the load's weight nor a
    # limit of the motor shows the scale.
    jobs: list[Job] = []
    for tried in some:
        for h in _with_train(tried) if UNMODELLED_INERTIA not in tried.base else ():
            row = of_inertia(h.fit.servos.theta[0], problem.strength(tried)[1])
            jobs.append((tried, h.members - {UNMODELLED_INERTIA}, row))
    problem.try_all(jobs)
    problem.spent_before += problem.batch.substeps - before  # not of the search's budget


def _follow(
    problem: ServoSearch, places: Sequence[tuple[Tried, Hypothesis, list[Candidate]]], most: int = 4
) -> None:
    """Fit the starts that are best at full strength, ``most`` of each branch, of other sizes."""
    places = [place for place in places if place[2]]
    with np.errstate(over="ignore", invalid="ignore"):  # some trains are unstable
        screens = problem.screened([place[:2] for place in places], [place[2] for place in places])
    jobs: list[Job] = []
    for (tried, h, options), seen in zip(places, screens, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            full = seen.score * seen.visible - 0.5 * seen.visible**2  # gains in log-likelihood
        for k, option in enumerate(options):
            mine = np.flatnonzero(seen.candidate == k)
            mine = mine[np.argsort(-full[mine], kind="stable")]
            starts = option.starts[seen.start[mine]]
            branch = option.branches(seen.start[mine])
            for one in np.unique(branch, axis=0):
                here = starts[(branch == one).all(axis=1)]
                first = np.sort(np.unique(here[:, 0], return_index=True)[1])[:most]
                for start in here[first]:
                    theta = h.fit.servos.theta[0].copy()
                    theta[option.columns] = start
                    members = h.members | {option.effect.name, UNMODELLED_INERTIA}
                    if theta[_RUB] == 0:
                        members -= {_COULOMB}
                    jobs.append((tried, members, theta))
    problem.try_all(jobs, free=True)


def of_inertia(theta: Array, load_kgm2: float, share: float = 0.0) -> Array:
    """A row (P,) that moves the same with another inertia beside the load, a share of it."""
    row = theta.copy()
    factor = load_kgm2 * (1 + share) / (load_kgm2 + row[INERTIA_LEFT_OUT])
    row[_SCALES] *= factor
    row[_SPRING] /= factor
    row[INERTIA_LEFT_OUT] = share * load_kgm2
    return row


def _with_train(tried: Tried) -> list[Hypothesis]:
    """The best set with each gear train, and with a free inertia."""
    free = [h for h in tried.tried.values() if UNMODELLED_INERTIA in h.members]
    of = [[h for h in free if name in h.members] for name in TRAINS]
    return [max(some, key=lambda h: h.evidence) for some in of if some]


def _of_gears(best: Hypothesis) -> Set:
    """Effects of a set that are dry friction or a gear train."""
    dry = named(_COULOMB).family
    return frozenset(e for e in best.members if named(e).family == dry or e in TRAINS)


def _places(problem: ServoSearch, some: Sequence[Tried]) -> Iterator[tuple[Tried, Hypothesis]]:
    """The plain servo, and the best set without friction and gears; both with Coulomb friction too.

    What else explains a joint may only imitate a gap, as a dead band does.
    """
    jobs: list[Job] = []
    for tried in some:
        row, gears = tried.best.fit.servos.theta[0], _of_gears(tried.best)
        torques = [
            float(row[FIRST_COLUMN[effect] + k])
            for effect in gears
            for k, parameter in enumerate(named(effect).parameters)
            if parameter.name in ("torque_Nm", "breakaway_Nm", _OUTPUT_FRICTION)
        ]
        rubbing = row.copy()
        rubbing[_RUB] = max(torques, default=0.0)
        # each once, and in an order that does not depend on the hashes of names
        for smooth in dict.fromkeys((tried.base, tried.best.members - gears)):
            jobs.append((tried, smooth, row))
            if rubbing[_RUB] > 0:
                jobs.append((tried, smooth | {_COULOMB}, rubbing))
    problem.try_all([job for job in jobs if job[1] not in job[0].tried])
    for tried, members, _ in jobs:
        yield tried, tried.tried[members]


def _grid(problem: ServoSearch, tried: Tried, place: Hypothesis, name: str) -> Candidate:
    """A gear train with all its starts, of the inertia and the dry friction of a fit."""
    effect, row = named(name), place.fit.servos.theta[0]
    values = _STARTS if name == "backlash" else _STARTS | {CONTROL_SIDE: (0.0, 1.0)}
    wide = tuple(replace(p, starts=values[p.name]) for p in effect.parameters)
    option = candidate(replace(effect, parameters=wide), *problem.strength(tried))
    starts, names = option.starts, [p.name for p in wide]
    rub = np.full(len(starts), row[_RUB])
    if _OUTPUT_FRICTION in names:
        moved = starts[:, names.index(_OUTPUT_FRICTION)]
        moved *= row[_RUB] / moved.max()
        rub -= moved
    left_out = row[INERTIA_LEFT_OUT] - starts[:, names.index("rotor_inertia_kgm2")]
    starts = np.column_stack([starts, rub, left_out])
    waves = [np.repeat([row[_WAVES] * share], len(starts), axis=0) for share in (1.0, 0.0)]
    starts = np.unique(np.vstack([np.hstack([starts, wave]) for wave in waves]), axis=0)
    columns = np.append(option.columns, [_RUB, INERTIA_LEFT_OUT, *_WAVES]).astype(np.int32)
    return replace(option, columns=columns, starts=starts)


def _around(
    problem: ServoSearch, tried: Tried, place: Hypothesis, width: float, *, draws: int = 400
) -> Candidate:
    """Gear trains around a fitted one, whose parameters differ by factors of up to exp(width)."""
    trains = sorted(place.members.intersection(TRAINS))
    options = [candidate(named(name), *problem.strength(tried)) for name in trains]
    columns, low, high = (
        np.concatenate([getattr(option, field) for option in options])
        for field in ("columns", "low", "high")
    )
    fitted = place.fit.servos.theta[0, columns]
    spread = kronecker(draws, columns.size, np.random.default_rng(0))
    spread[:, [COLUMNS[k].endswith(CONTROL_SIDE) for k in columns]] = 0.5
    starts = np.clip(fitted * np.exp(width * (2 * spread - 1)), low, high)
    rotor = int(np.flatnonzero(np.isin(columns, TRAIN_ROTORS))[0])
    left_out = place.fit.servos.theta[0, INERTIA_LEFT_OUT] + fitted[rotor] - starts[:, rotor]
    columns = np.append(columns, INERTIA_LEFT_OUT).astype(np.int32)
    return replace(options[0], columns=columns, starts=np.column_stack([starts, left_out]))
