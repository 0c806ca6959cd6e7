"""Which effects does each joint need? The servo's side of the search of ``inference.selection``.

First what every servo has a little of: cogging and the sensor's eccentricity are common to all
recordings, and nobody acts on a little of them. Left out, their waves pass for anything. They are
fitted beside whatever else explains most, so that they do not stand in for it, and belong to the
plain servo while they are small in noises.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.effects import named
from sim2real.inference import selection
from sim2real.inference.evidence import occam_factor
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.plain import BLOCKS, own_parameters, with_effects
from sim2real.servo.problem import Fits, Hypothesis, Set, Tried, joined, minimise, stacked
from sim2real.servo.screen import NUISANCES, Candidate, Screen, candidate, candidates, screen

Array = NDArray[np.float64]
Job = tuple[Tried, Set, Array]
"""What was tried on a joint, the set of effects to refit, and the parameters to start from."""

BREADTH = selection.Breadth()
_BETTER = 1.0
_SINGLES, _HOPELESS = 24, 1.0
"""Starts of single effects that are followed, and the gain at first sight below which none is."""
_BESIDE = 4
"""Effects that are tried beside the plain servo, to fit nuisances with the best of them."""
_STARTS = 2
_WORTH = 5.0
"""Evidence that nuisances must earn."""


def search(
    batch: Batch,
    plain: Fits,
    *,
    level: float,
    rng: np.random.Generator,
    noise: Sequence[float] | None = None,
    bases: Sequence[Set] | None = None,
    progress: Callable[[float], None] = lambda share: None,
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
        progress: Called with the share that is done.

    Returns:
        What was tried, one a joint, and what may be asked of it further.
    """
    ledgers: list[Tried] = []
    for j in range(plain.count.size):
        base: Set = bases[j] if bases else frozenset()
        fit = plain.one(j)
        ledgers.append(Tried(j, base))
        ledgers[-1].keep(Hypothesis(base, fit, _evidence(fit, frozenset())))
    problem = ServoSearch(batch, level, rng)
    if noise is not None:
        ledgers = _with_nuisances(problem, ledgers, noise)
    progress(0.15)
    selection.select(problem, ledgers, selection.Breadth(most=1))
    progress(0.3)
    again = problem.rebased(ledgers)
    if again:
        selection.select(problem, again, selection.Breadth(most=1))
    problem.singles = False
    selection.select(problem, ledgers, BREADTH, lambda share: progress(0.4 + 0.6 * share))
    return ledgers, problem


class ServoSearch:
    """What the search asks of the servos of a batch: see ``selection.Problem``.

    Args:
        batch: The recordings.
        level: Share of joints with nothing missing that may be searched beyond single effects.
        rng: For the bootstrap.
    """

    def __init__(self, batch: Batch, level: float, rng: np.random.Generator) -> None:
        self.batch, self.level, self.rng = batch, level, rng
        self.held: dict[int, Set] = {}
        """Effects of each case that stay as they are."""
        self.singles = True
        """Whether every effect by itself is still to be tried."""
        self._seen: dict[tuple[int, Set], tuple[Screen, list[Candidate]]] = {}

    def seen(self, ledger: Tried, members: Set) -> tuple[Screen, list[Candidate]]:
        """What every effect that may join a set would explain of what it leaves."""
        self.look([(ledger, members)])
        return self._seen[ledger.case, members]

    def look(self, pairs: Sequence[tuple[Tried, Set]]) -> None:
        """Screen all other effects from each of these sets; sets of one size share a launch."""
        new = {(one.case, s): (one, s) for one, s in pairs if (one.case, s) not in self._seen}
        lists = [candidates(s, *self.strength(one)) for one, s in new.values()]
        seen = self.screened([(one, one.tried[s]) for one, s in new.values()], lists)
        self._seen.update(zip(new, zip(seen, lists, strict=True), strict=True))

    def screened(
        self, places: Sequence[tuple[Tried, Hypothesis]], lists: Sequence[list[Candidate]]
    ) -> list[Screen]:
        """What these candidates would explain of what each hypothesis leaves."""
        found: dict[int, Screen] = {}
        widths = [h.fit.servos.columns.shape[1] for _, h in places]
        for width in sorted(set(widths)):
            some = [k for k, w in enumerate(widths) if w == width]
            fits = joined([places[k][1].fit for k in some])
            # A finding may have been moved to a place in another batch.
            joint = np.array([places[k][0].case for k in some], dtype=np.int32)
            fits = replace(fits, servos=replace(fits.servos, joint=joint))
            seen = screen(self.batch, fits, [lists[k] for k in some], blocks=BLOCKS)
            found.update(zip(some, seen, strict=True))
        return [found[k] for k in range(len(places))]

    def additions(self, ledger: Tried, members: Set, most: int | None) -> list[tuple[str, Array]]:
        """The effects that explain most from a set, each with a parameter row to start from."""
        if most is None and not self.singles:
            return []
        seen, given = self.seen(ledger, members)
        gain, each = seen.gain, 2 if most is None else 1
        chosen: list[tuple[float, str, Array]] = []
        for k, option in enumerate(given):
            mine = np.flatnonzero(seen.candidate == k)
            for index in mine[np.argsort(-gain[mine])][:each]:
                theta = self.start(ledger, members, members)
                theta[option.columns] = option.starts[seen.start[index]]
                chosen.append((float(gain[index]), option.effect.name, theta))
        chosen.sort(key=lambda entry: -entry[0])
        if most is None:
            chosen = [entry for entry in chosen if entry[0] > _HOPELESS][:_SINGLES]
        return [(name, theta) for _, name, theta in chosen[:most]]

    def start(self, ledger: Tried, members: Set, of: Set | None = None) -> Array:
        """The parameter row of a set, or of the best one."""
        known = ledger.best if of is None else ledger.tried[of]
        return np.array(known.fit.servos.theta[0])

    def refit(self, jobs: Sequence[Job]) -> list[Hypothesis]:
        """Refit sets of effects from parameter rows; the best of several starts stands for all."""
        if not jobs:
            return []
        servos = [
            with_effects(
                one.plain.fit.servos,
                members,
                theta,
                *self.strength(one),
                self.held.get(one.case, frozenset()),
            )
            for one, members, theta in jobs
        ]
        rough = minimise(self.batch, stacked(servos), iterations=5)
        best: dict[tuple[int, Set], int] = {}
        for k, (ledger, members, _) in enumerate(jobs):
            key = (ledger.case, members)
            if key not in best or rough.error2[k] < rough.error2[best[key]]:
                best[key] = k
        index = np.array(list(best.values()))
        fine = minimise(self.batch, rough.servos[index], iterations=15, blocks=BLOCKS)
        fits = {key: fine.one(n) for n, key in enumerate(best)}
        return [
            Hypothesis(s, fits[one.case, s], _evidence(fits[one.case, s], s - one.base))
            for one, s, _ in jobs
        ]

    def remains(self, ledger: Tried, members: Set) -> bool:
        """Whether some effect would still explain more than chance.

        What every servo has a little of does not count: it is named only where it is large.
        """
        gain, limit = self.left(ledger, members)
        return gain > limit

    def left(self, ledger: Tried, members: Set) -> tuple[float, float]:
        """Largest gain that an effect would still make, and what chance would make."""
        seen, given = self.seen(ledger, members)
        counted = seen.of(np.array([not c.effect.everywhere for c in given]))
        limit = min(counted.threshold(self.level, self.rng), DECISION.surely)
        return float(counted.gain.max()), limit

    def rebased(self, ledgers: Sequence[Tried]) -> list[Tried]:
        """Those whose plain servo fits better with the gains that the best single effect found."""
        before = [one.plain.evidence for one in ledgers]
        jobs = [(one, one.base, self.start(one, one.base)) for one in ledgers]
        better = []
        for one, found, old in zip(ledgers, self.refit(jobs), before, strict=True):
            one.keep(found)
            if one.plain.evidence > old + _BETTER:
                better.append(one)
                del self._seen[one.case, one.base]
        return better

    def strength(self, ledger: Tried) -> tuple[float, float]:
        """The plain servo's gain and inertia."""
        first = self.batch.first_signal[ledger.case]
        return float(ledger.plain.fit.servos.theta[0, 0]), float(self.batch.load[first, 0])


def size_in_noise(best: Hypothesis, effect: str, noise_rad: float) -> float:
    """An effect's size as the angle that it turns the servo by, in noises of the sensor."""
    theta = best.fit.servos.theta[0]
    first = named(effect).parameters[0].name
    size = theta[COLUMNS.index(f"{effect}.{first}")]
    return float(size / (theta[0] if first.endswith("_Nm") else 1.0) / noise_rad)


def _with_nuisances(
    problem: ServoSearch, ledgers: Sequence[Tried], noise: Sequence[float]
) -> list[Tried]:
    """The ledgers, each plain servo with the nuisances that show and are small.

    ``noise`` is the standard deviation of each joint's sensor in rad.
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
    wanted = [one for one in ledgers if any(_missing(beside[one.case].members))]
    tried: dict[int, list[Hypothesis]] = {one.case: [] for one in wanted}
    jobs = _beside(problem, wanted) if wanted else []
    for (one, _, _), found in zip(jobs, problem.refit(jobs), strict=True):
        tried[one.case].append(found)
    jobs = []
    for one in wanted:
        best = _best(beside[one.case], tried[one.case], noise[one.case])
        if best is not None and (more := _small(best, noise[one.case]) - one.base):
            # As fitted beside the best effect, and so they stay.
            problem.held[one.case] = more
            jobs.append((one, one.base | more, np.array(best.fit.servos.theta[0])))
    based = {}
    for (one, members, _), found in zip(jobs, problem.refit(jobs), strict=True):
        based[one.case] = Tried(one.case, members)
        based[one.case].keep(found)
    return [based.get(one.case, one) for one in ledgers]


def _missing(members: Set) -> list[str]:
    return [e.name for e in NUISANCES if e.name not in members]


def _beside(problem: ServoSearch, ledgers: Sequence[Tried]) -> list[Job]:
    """Every set of nuisances beside the best effect of each, from the likeliest waves."""
    places = [(one, one.best) for one in ledgers]
    lists = [
        [candidate(named(n), *problem.strength(one)) for n in _missing(best.members)]
        for one, best in places
    ]
    jobs = []
    for (one, best), given, seen in zip(
        places, lists, problem.screened(places, lists), strict=True
    ):
        starts: dict[str, list[Array]] = {}
        for k, option in enumerate(given):
            mine = np.flatnonzero(seen.candidate == k)
            likeliest = mine[np.argsort(-seen.gain[mine])][:_STARTS]
            starts[option.effect.name] = [option.starts[seen.start[i]] for i in likeliest]
        columns = {option.effect.name: option.columns for option in given}
        for count in range(1, len(given) + 1):
            for names in combinations(starts, count):
                for turn in range(_STARTS):
                    theta = np.array(best.fit.servos.theta[0])
                    for name in names:
                        theta[columns[name]] = starts[name][min(turn, len(starts[name]) - 1)]
                    jobs.append((one, best.members | set(names), theta))
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


def _evidence(fit: Fits, added: Set) -> float:
    """Laplace's approximation of the evidence of effects, with their prior."""
    information = fit.gram.sum(axis=1)[:, 1:, 1:] / (fit.error2 / fit.count)[:, None, None]
    nuisance = int(own_parameters(fit.servos).sum())
    occam = occam_factor(information, DECISION.prior_sd, nuisance=nuisance)
    return float(fit.loglikelihood[0] - occam[0]) + len(added) * LOG_PRIOR
