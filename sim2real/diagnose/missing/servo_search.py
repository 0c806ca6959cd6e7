"""What a search for missing effects asks of the servos of a batch: starts, refits, evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.missing.baseline import BLOCKS, as_read, own_parameters, with_effects
from sim2real.diagnose.missing.screening import Candidate, Screen, candidates, screen
from sim2real.effects import named
from sim2real.identification.servo_problem import (
    Fits,
    Hypothesis,
    Set,
    Tried,
    joined,
    minimise,
    stacked,
)
from sim2real.inference.evidence import occam_factor
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import FIRST_COLUMN

Job = tuple[Tried, Set, Array]
"""What was tried on a joint, the set of effects to refit, and the parameters to start from."""

_GAIN = "sensor_gain"
_TRAINS = {
    name: (FIRST_COLUMN[name], 1e-3 * named(name).parameters[0].typical)
    for name in ("backlash", "compliance")
}
"""Columns of the sizes of gear trains, and sizes from which on they are there."""


@dataclass(frozen=True)
class SearchLimits:
    """How far the search for effects goes, and what it gives up.

    Attributes:
        min_rebase_gain: Evidence by which the plain servo must fit better with the gains that the
            best single effect found.
        rivals: Sets that are refitted with nothing held.
        near: How far the evidence of such a set may be behind the best.
        hopeless_gain: Gain at first sight below which the best start of an effect is not followed.
        least_visible: Score of an effect, were it there, from which it would be seen.
        promise: Times the gain that a fit's quadratic model promises, which it may still make.
        effort: Multiple of the budget ``DECISION.search_substeps``.
    """

    min_rebase_gain: float = 1.0
    rivals: int = 10
    near: float = 80.0
    hopeless_gain: float = 1.0
    least_visible: float = 3.0
    promise: float = 6.0
    effort: float = 1.0


SEARCH_LIMITS = SearchLimits()
"""The defaults."""


def ledgers_of(plain: Fits, bases: Sequence[Set] | None = None) -> list[Tried]:
    """What was tried on each joint before a search: its plain servo.

    Args:
        plain: The fits, one a joint.
        bases: Effects that each joint's given model has.
    """
    ledgers = []
    for j in range(plain.count.size):
        base: Set = bases[j] if bases else frozenset()
        fit = plain.single(j)
        ledgers.append(Tried(j, base))
        ledgers[-1].keep(Hypothesis(base, fit, _evidence(fit, frozenset())))
    return ledgers


class ServoSearch:
    """What the search asks of the servos of a batch: see ``selection.Problem``.

    Args:
        batch: The recordings.
        level: Share of joints with nothing missing that may be searched beyond single effects.
        rng: For the bootstrap.
        limits: How far it goes.
    """

    def __init__(
        self,
        batch: Batch,
        level: float,
        rng: np.random.Generator,
        *,
        limits: SearchLimits = SEARCH_LIMITS,
    ) -> None:
        self.batch, self.level, self.rng, self.limits = batch, level, rng, limits
        self.held: dict[int, Set] = {}
        """Effects of each case that stay as they are."""
        self.released: dict[int, Set] = {}
        """Those that were held before the last ``release``."""
        self.singles = True
        """Whether every effect by itself is still to be tried."""
        self.unfinished: set[int] = set()
        """Cases whose search was ended by its budget, ``DECISION.search_substeps``."""
        self._spent_before = batch.substeps.copy()
        self._seen: dict[tuple[int, Set], tuple[Screen, list[Candidate]]] = {}

    def seen(self, ledger: Tried, members: Set) -> tuple[Screen, list[Candidate]]:
        """What every effect that may join a set would explain of what it leaves."""
        self.look([(ledger, members)])
        return self._seen[ledger.case, members]

    def look(self, pairs: Sequence[tuple[Tried, Set]]) -> None:
        """Screen all other effects from each of these sets; sets of one size share a launch."""
        new = {
            (ledger.case, s): (ledger, s)
            for ledger, s in pairs
            if (ledger.case, s) not in self._seen
        }
        lists = [candidates(s, *self.strength(ledger)) for ledger, s in new.values()]
        seen = self.screened([(ledger, ledger.tried[s]) for ledger, s in new.values()], lists)
        self._seen.update(zip(new, zip(seen, lists, strict=True), strict=True))

    def screened(
        self, places: Sequence[tuple[Tried, Hypothesis]], lists: Sequence[list[Candidate]]
    ) -> list[Screen]:
        """What these candidates would explain of what each hypothesis leaves."""
        screens: dict[int, Screen] = {}
        widths = [h.fit.servos.columns.shape[1] for _, h in places]
        for width in sorted(set(widths)):
            same = [k for k, w in enumerate(widths) if w == width]
            # A finding may have been moved to a place in another batch.
            fits = joined([places[k][1].fit for k in same])
            fits = fits.of_joints([places[k][0].case for k in same])
            seen = screen(self.batch, fits, [lists[k] for k in same], blocks=BLOCKS)
            screens.update(zip(same, seen, strict=True))
        return [screens[k] for k in range(len(places))]

    def additions(self, ledger: Tried, members: Set, most: int | None) -> list[tuple[str, Array]]:
        """The effects that explain most from a set, each with a parameter row to start from.

        Where all are tried and something is missing, every effect also starts at its weakest that
        would be seen: gains that have absorbed an effect hide it from a linear look, but a fit
        that starts near them finds it.
        """
        if most is None and not self.singles:
            return []
        seen, options = self.seen(ledger, members)
        gain = seen.gain
        starts: list[tuple[float, int]] = []
        weakest = most is None and self.remains(ledger, members)
        for k, option in enumerate(options):
            mine = np.flatnonzero(seen.candidate == k)
            best = int(mine[gain[mine].argmax()])
            if most is not None or gain[best] > self.limits.hopeless_gain:
                starts.append((float(gain[best]), best))
            visible = mine[seen.visible[mine] > self.limits.least_visible]
            if weakest and visible.size and not option.effect.everywhere:
                weak = int(visible[seen.visible[visible].argmin()])
                if (float(gain[weak]), weak) not in starts:
                    starts.append((float(gain[weak]), weak))
        starts.sort(key=lambda entry: -entry[0])
        chosen = []
        for _, index in starts[:most]:
            option = options[seen.candidate[index]]
            theta = ledger.tried[members].fit.servos.theta[0].copy()
            theta[option.columns] = option.starts[seen.start[index]]
            chosen.append((option.effect.name, theta))
        return chosen

    def start(self, ledger: Tried, members: Set) -> Array:
        """The parameter row of the best set, from which every other is refitted."""
        return np.array(ledger.best.fit.servos.theta[0])

    def refit(self, jobs: Sequence[Job]) -> list[Hypothesis]:
        """Refit sets of effects from parameter rows; the best of several starts stands for all."""
        if not jobs:
            return []
        servos = [
            with_effects(
                ledger.plain.fit.servos,
                members,
                as_read(theta, members),
                self.strength(ledger)[1],
                self.held.get(ledger.case, frozenset()),
            )
            for ledger, members, theta in jobs
        ]
        rough = minimise(self.batch, stacked(servos), iterations=5, blocks=BLOCKS)
        best: dict[tuple[int, Set], int] = {}
        for k, (ledger, members, _) in enumerate(jobs):
            key = (ledger.case, members)
            if key not in best or rough.error2[k] < rough.error2[best[key]]:
                best[key] = k
        fits = {key: rough.single(k) for key, k in best.items()}
        keys = [key for key, k in best.items() if not rough.converged[k]]
        goal = self._goals(jobs, fits)
        promised = {key: _promised(fits[key]) for key in keys}
        keys = [
            key
            for key in keys
            if float(fits[key].loglikelihood[0]) + self.limits.promise * promised[key] > goal[key]
        ]
        if keys:
            index = np.array([best[key] for key in keys])
            goals = np.array([goal[key] for key in keys])

            def hopeless(places: Index, _: Array, losses: Array, promised: Array) -> Mask:
                reachable = self.limits.promise * promised - losses[places]
                return np.asarray(reachable < goals[places])

            fine = minimise(
                self.batch, rough.servos[index], iterations=15, blocks=BLOCKS, hopeless=hopeless
            )
            fits.update((key, fine.single(n)) for n, key in enumerate(keys))
        return [
            Hypothesis(s, fits[ledger.case, s], _evidence(fits[ledger.case, s], s - ledger.base))
            for ledger, s, _ in jobs
        ]

    def _goals(
        self, jobs: Sequence[Job], fits: Mapping[tuple[int, Set], Fits]
    ) -> dict[tuple[int, Set], float]:
        """Log-likelihood from which each set matters, among those of its case.

        Sets with another gain of the sensor are compared however far behind they are.
        """
        top: dict[int, float] = {}
        for ledger, members, _ in jobs:
            here = float(fits[ledger.case, members].loglikelihood[0])
            known = float(ledger.best.fit.loglikelihood[0])
            top[ledger.case] = max(here, known, top.get(ledger.case, -np.inf))
        return {
            (ledger.case, members): -np.inf
            if _GAIN in members
            else top[ledger.case] - self.limits.near
            for ledger, members, _ in jobs
        }

    def release(self, ledgers: Sequence[Tried]) -> None:
        """Refit the likeliest sets of each case, and the plain one, with nothing held.

        What was held was fitted with the likeliest set of that time, and favours it.
        """
        held = [
            (ledger, h)
            for ledger in ledgers
            if self.held.get(ledger.case)
            for h in _likely(ledger, self.limits)
        ]
        self.released, self.held = self.held, {}
        jobs = [(ledger, h.members, h.fit.servos.theta[0]) for ledger, h in held]
        for (ledger, h), refitted in zip(held, self.refit(jobs), strict=True):
            more = float(refitted.fit.loglikelihood[0] - h.fit.loglikelihood[0])
            # All are as free: what freedom costs is the same for each.
            if more > 0:
                ledger.tried[h.members] = replace(refitted, evidence=h.evidence + more)
                self._seen.pop((ledger.case, h.members), None)

    def remains(self, ledger: Tried, members: Set) -> bool:
        """Whether some effect would still explain more than chance.

        What every servo has a little of must explain as much as is never left to chance.
        """
        gain, limit = self.remaining_gain(ledger, members)
        return (
            gain > limit or float(self.seen(ledger, members)[0].gain.max()) > DECISION.decisive_gain
        )

    def exhausted(self, ledger: Tried) -> bool:
        """Whether a case that would be searched further has spent its budget; noted down if so.

        The budget is counted in sub-steps of rollouts, so that no answer depends on the machine.
        """
        spent = self.batch.substeps[ledger.case] - self._spent_before[ledger.case]
        if spent > self.limits.effort * DECISION.search_substeps:
            self.unfinished.add(ledger.case)
        return ledger.case in self.unfinished

    def remaining_gain(self, ledger: Tried, members: Set) -> tuple[float, float]:
        """Largest gain that an effect would still make, and what chance would make.

        What every servo has a little of does not count: it is named only where it is large.
        """
        seen, options = self.seen(ledger, members)
        counted = seen.of(np.array([not option.effect.everywhere for option in options]))
        limit = min(counted.threshold(self.level, self.rng), DECISION.decisive_gain)
        return float(counted.gain.max()), limit

    def rebased(self, ledgers: Sequence[Tried]) -> list[Tried]:
        """Those whose plain servo fits better with the gains that the best single effect found."""
        before = [ledger.plain.evidence for ledger in ledgers]
        jobs = [(ledger, ledger.base, self.start(ledger, ledger.base)) for ledger in ledgers]
        better = []
        for ledger, refitted, old in zip(ledgers, self.refit(jobs), before, strict=True):
            ledger.keep(refitted)
            if ledger.plain.evidence > old + self.limits.min_rebase_gain:
                better.append(ledger)
                del self._seen[ledger.case, ledger.base]
        return better

    def strength(self, ledger: Tried) -> tuple[float, float]:
        """The plain servo's gain and inertia."""
        first = self.batch.first_signal[ledger.case]
        return float(ledger.plain.fit.servos.theta[0, 0]), float(self.batch.load[first, 0])


def _likely(ledger: Tried, limits: SearchLimits) -> list[Hypothesis]:
    """The sets that the diagnosis compares: the best, the best without each effect, its rivals.

    What was held fits none with another gain of the sensor, however far behind they are.
    """
    best, tried = ledger.best, ledger.tried
    near = sorted(tried.values(), key=lambda h: -h.evidence)[: limits.rivals]
    scaled = _GAIN in best.members
    sets = [
        h.members
        for h in near
        if h.evidence > best.evidence - limits.near or (_GAIN in h.members) != scaled
    ]
    sets += [ledger.base, *(best.members - {e} for e in best.members - ledger.base)]
    return [tried[s] for s in dict.fromkeys(sets) if s in tried]


def _promised(fit: Fits) -> float:
    """Gain in log-likelihood that the next full step of a lone fit promises."""
    total = fit.gram[0].sum(axis=0)
    inverse = np.linalg.pinv(total[1:, 1:], rcond=1e-10, hermitian=True)
    share = float(total[0, 1:] @ inverse @ total[1:, 0]) / max(float(total[0, 0]), 1e-300)
    return -0.5 * float(fit.count[0]) * float(np.log1p(-min(share, 1 - 1e-9)))


def _evidence(fit: Fits, added: Set) -> float:
    """Laplace's approximation of the evidence of effects, with their prior.

    -inf if it diverges, or if a gear train has neither gap nor spring: what then explains the
    recordings is its rotor or its friction, which have effects of their own.
    """
    theta = fit.servos.theta[0]
    if any(theta[column] < least for name, (column, least) in _TRAINS.items() if name in added):
        return -np.inf
    information = fit.gram.sum(axis=1)[:, 1:, 1:] / (fit.error2 / fit.count)[:, None, None]
    if not np.isfinite(information).all():
        return -np.inf
    nuisance = int(own_parameters(fit.servos).sum())
    occam = occam_factor(information, DECISION.prior_sd, nuisance=nuisance)
    return float(fit.loglikelihood[0] - occam[0]) + len(added) * LOG_PRIOR
