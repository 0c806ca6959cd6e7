"""What every servo has a little of: part of the plain servo, before anything is looked for.

Cogging and the sensor's eccentricity are common to all recordings, and nobody acts on a little of
them. Left out, their waves pass for anything. They are fitted beside whatever else explains most,
so that they do not stand in for it, and kept while they are small in noises.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from sim2real.diagnose.decision import DECISION
from sim2real.effects import named
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.screen import NUISANCES, candidate

if TYPE_CHECKING:
    from sim2real.diagnose.search import Found, Hypothesis, ServoSearch, Set

_BESIDE = 4
"""Effects that are tried beside the plain servo, to fit nuisances with the best of them."""
_STARTS = 2
_WORTH = 5.0
"""Evidence that nuisances must earn."""


def size_in_noise(best: Hypothesis, effect: str, noise_rad: float) -> float:
    """An effect's size as the angle that it turns the servo by, in noises of the sensor."""
    theta = best.fit.servos.theta[0]
    first = named(effect).parameters[0].name
    size = theta[COLUMNS.index(f"{effect}.{first}")]
    return float(size / (theta[0] if first.endswith("_Nm") else 1.0) / noise_rad)


def with_nuisances(
    problem: ServoSearch, ledgers: Sequence[Found], noise: Sequence[float]
) -> list[Found]:
    """The ledgers, each plain servo with the nuisances that show and are small.

    Args:
        problem: The search to come.
        ledgers: One a joint, of plain servos.
        noise: Standard deviation of each joint's sensor, rad.
    """
    problem.look([(one, one.base) for one in ledgers])
    jobs = [
        (one, one.base | {name}, start)
        for one in ledgers
        for name, start in problem.additions(one, one.base, _BESIDE)
    ]
    for (one, _, _), found in zip(jobs, problem.refit(jobs), strict=True):
        one.keep(found)
    beside = {one.case: one.best for one in ledgers}
    wanted = [one for one in ledgers if _missing(beside[one.case].members)]
    if not wanted:
        return list(ledgers)
    jobs = _jobs(problem, wanted, beside)
    tried: dict[int, list[Hypothesis]] = {one.case: [] for one in wanted}
    for (one, _, _), found in zip(jobs, problem.refit(jobs), strict=True):
        tried[one.case].append(found)
    chosen = {case: _best(beside[case], some, noise[case]) for case, some in tried.items()}
    jobs = []
    for one in wanted:
        best = chosen[one.case]
        more = _small(best, noise[one.case]) if best is not None else frozenset()
        if best is not None and more - one.base:
            # As fitted beside the best effect, and so they stay.
            problem.held[one.case] = more - one.base
            jobs.append((one, one.base | more, np.array(best.fit.servos.theta[0])))
    based = {}
    for (one, members, _), found in zip(jobs, problem.refit(jobs) if jobs else (), strict=True):
        ledger = type(one)(one.case, members)
        ledger.keep(found)
        based[one.case] = ledger
    return [based.get(one.case, one) for one in ledgers]


def _missing(members: Set) -> list[str]:
    return [e.name for e in NUISANCES if e.name not in members]


def _jobs(
    problem: ServoSearch, ledgers: Sequence[Found], beside: dict[int, Hypothesis]
) -> list[tuple[Found, Set, np.ndarray]]:
    """Every set of nuisances beside the best effect, from the likeliest waves."""
    lists = [
        [candidate(named(n), *problem.strength(one)) for n in _missing(beside[one.case].members)]
        for one in ledgers
    ]
    jobs = []
    for one, given, seen in zip(
        ledgers, lists, problem.screened([beside[x.case] for x in ledgers], lists), strict=True
    ):
        base = beside[one.case]
        starts: dict[str, list[np.ndarray]] = {}
        for k, option in enumerate(given):
            mine = np.flatnonzero(seen.candidate == k)
            best = mine[np.argsort(-seen.gain[mine])][:_STARTS]
            starts[option.effect.name] = [option.starts[seen.start[i]] for i in best]
        columns = {option.effect.name: option.columns for option in given}
        for count in range(1, len(given) + 1):
            for names in combinations(starts, count):
                for turn in range(_STARTS):
                    theta = np.array(base.fit.servos.theta[0])
                    for name in names:
                        theta[columns[name]] = starts[name][min(turn, len(starts[name]) - 1)]
                    jobs.append((one, base.members | set(names), theta))
    return jobs


def _best(beside: Hypothesis, tried: Sequence[Hypothesis], noise_rad: float) -> Hypothesis | None:
    """The likeliest set whose nuisances are all small; None where none is worth it."""
    nuisances = {e.name for e in NUISANCES}
    small = [h for h in tried if _small(h, noise_rad) == h.members & nuisances]
    best = max([beside, *small], key=lambda h: h.evidence)
    return best if best.evidence > beside.evidence + _WORTH or best is beside else None


def _small(found: Hypothesis, noise_rad: float) -> Set:
    """Those of its nuisances that are small."""
    given = [e.name for e in NUISANCES if e.name in found.members]
    return frozenset(
        name for name in given if size_in_noise(found, name, noise_rad) < DECISION.ripple
    )
