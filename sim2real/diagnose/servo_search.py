"""What a search for missing effects asks of the servos of a batch: starts, refits, evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.diagnose.baseline import BLOCKS, as_read, own_parameters, with_effects
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.screening import Candidate, Screen, candidates, screen
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
    """How far the search for effects goes; gains and evidence are in nats."""

    min_rebase_gain: float = 1.0  # by which a plain servo must fit better with other gains
    rivals: int = 10  # sets that are refitted with nothing fixed
    near: float = 80.0  # how far the evidence of such a set may be behind the best
    hopeless_gain: float = 1.0  # at first sight, below which the best start is not followed
    least_visible: float = 3.0  # score of an effect, were it there, from which it would be seen
    promise: float = 6.0  # times the gain that a fit's quadratic model promises
    effort: float = 1.0  # multiple of the budget ``DECISION.search_substeps``


class ServoSearch:
    """What the search asks of the servos of a batch: see ``selection.Problem``.

    Attributes:
        fixed: By case, effects whose parameters stay as they are.
        singles: Whether every effect by itself is still to be tried.
        unfinished: Cases whose search was ended by its budget, ``DECISION.search_substeps``.
    """

    def __init__(
        self, batch: Batch, level: float, rng: np.random.Generator, effort: float = 1.0
    ) -> None:
        self.batch, self.level, self.rng = batch, level, rng
        self.limits = SearchLimits(effort=effort)
        self.fixed: dict[int, Set] = {}
        self._fixed_before: dict[int, Set] = {}
        self.singles = True
        self.unfinished: set[int] = set()
        self._spent_before = batch.substeps.copy()
        self._screens: dict[tuple[int, Set], tuple[Screen, list[Candidate]]] = {}

    def try_all(self, jobs: Sequence[Job]) -> None:
        """Refit sets of effects, and record them."""
        for (tried, _, _), hypothesis in zip(jobs, self.refit(jobs), strict=True):
            tried.keep(hypothesis)

    def seen(self, tried: Tried, members: Set) -> tuple[Screen, list[Candidate]]:
        """What every effect that may join a set would explain of what it leaves."""
        self.look([(tried, members)])
        return self._screens[tried.case, members]

    def look(self, pairs: Sequence[tuple[Tried, Set]]) -> None:
        """Screen all other effects from each of these sets; sets of one size share a launch."""
        new = {
            (tried.case, s): (tried, s)
            for tried, s in pairs
            if (tried.case, s) not in self._screens
        }
        lists = [candidates(s, *self.strength(tried)) for tried, s in new.values()]
        screens = self.screened([(tried, tried.tried[s]) for tried, s in new.values()], lists)
        self._screens.update(zip(new, zip(screens, lists, strict=True), strict=True))

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
            found = screen(self.batch, fits, [lists[k] for k in same], blocks=BLOCKS)
            screens.update(zip(same, found, strict=True))
        return [screens[k] for k in range(len(places))]

    def additions(self, tried: Tried, members: Set, most: int | None) -> list[tuple[str, Array]]:
        """The effects that explain most from a set, each with a parameter row to start from.

        Where all are tried and something is missing, every effect also starts at its weakest that
        would be seen: gains that have absorbed an effect hide it from a linear look, but not from a
        fit that starts near it.
        """
        if most is None and not self.singles:
            return []
        seen, options = self.seen(tried, members)
        gain = seen.gain
        starts: list[tuple[float, int]] = []
        weakest = most is None and self.remains(tried, members)
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
            theta = tried.tried[members].fit.servos.theta[0].copy()
            theta[option.columns] = option.starts[seen.start[index]]
            chosen.append((option.effect.name, theta))
        return chosen

    def start(self, tried: Tried, members: Set) -> Array:
        """The parameter row of the best set, from which every other is refitted."""
        return np.array(tried.best.fit.servos.theta[0])

    def refit(self, jobs: Sequence[Job]) -> list[Hypothesis]:
        """Refit sets of effects from parameter rows; the best of several starts stands for all."""
        if not jobs:
            return []
        servos = [
            with_effects(
                tried.plain.fit.servos,
                members,
                as_read(theta, members),
                self.strength(tried)[1],
                self.fixed.get(tried.case, frozenset()),
            )
            for tried, members, theta in jobs
        ]
        rough = minimise(self.batch, stacked(servos), iterations=5, blocks=BLOCKS)
        best: dict[tuple[int, Set], int] = {}
        for k, (tried, members, _) in enumerate(jobs):
            key = (tried.case, members)
            if key not in best or rough.error2[k] < rough.error2[best[key]]:
                best[key] = k
        fits = {key: rough.single(k) for key, k in best.items()}
        goal = self._goals(jobs, fits)
        keys = [key for key, k in best.items() if not rough.converged[k]]
        keys = [
            key
            for key in keys
            if float(fits[key].loglikelihood[0]) + self.limits.promise * _promised(fits[key])
            > goal[key]
        ]
        if keys:
            goals = np.array([goal[key] for key in keys])

            def hopeless(places: Index, _: Array, losses: Array, promised: Array) -> Mask:
                reachable = self.limits.promise * promised - losses[places]
                return np.asarray(reachable < goals[places])

            servos_left = rough.servos[np.array([best[key] for key in keys])]
            fine = minimise(
                self.batch, servos_left, iterations=15, blocks=BLOCKS, hopeless=hopeless
            )
            fits.update((key, fine.single(n)) for n, key in enumerate(keys))
        return [
            Hypothesis(s, fits[tried.case, s], evidence_of(fits[tried.case, s], s - tried.base))
            for tried, s, _ in jobs
        ]

    def _goals(
        self, jobs: Sequence[Job], fits: Mapping[tuple[int, Set], Fits]
    ) -> dict[tuple[int, Set], float]:
        """Log-likelihood from which each set matters, among those of its case."""
        top: dict[int, float] = {}
        for tried, members, _ in jobs:
            here = float(fits[tried.case, members].loglikelihood[0])
            known = float(tried.best.fit.loglikelihood[0])
            top[tried.case] = max(here, known, top.get(tried.case, -np.inf))
        near = {case: x - self.limits.near for case, x in top.items()}
        return {
            (tried.case, members): -np.inf if _GAIN in members else near[tried.case]
            for tried, members, _ in jobs
        }

    def release(self, cases: Sequence[Tried]) -> None:
        """Refit the most probable sets of each case, and the plain one, with nothing fixed.

        What was fixed was fitted with the most probable set of that time, and favours it.
        """
        fixed = [
            (tried, h)
            for tried in cases
            if self.fixed.get(tried.case)
            for h in self.compared(tried)
        ]
        self._fixed_before, self.fixed = self.fixed, {}
        jobs = [(tried, h.members, h.fit.servos.theta[0]) for tried, h in fixed]
        for (tried, h), refitted in zip(fixed, self.refit(jobs), strict=True):
            more = float(refitted.fit.loglikelihood[0] - h.fit.loglikelihood[0])
            # All are as free: what freedom costs is the same for each.
            if more > 0:
                tried.tried[h.members] = replace(refitted, evidence=h.evidence + more)
                self._screens.pop((tried.case, h.members), None)

    def compared(self, tried: Tried) -> list[Hypothesis]:
        """The sets that are compared: the best, the best without each effect, its rivals."""
        best = tried.best
        near = sorted(tried.tried.values(), key=lambda h: -h.evidence)[: self.limits.rivals]
        scaled = _GAIN in best.members
        sets = [
            h.members
            for h in near
            if h.evidence > best.evidence - self.limits.near or (_GAIN in h.members) != scaled
        ]
        sets += [tried.base, *(best.members - {e} for e in best.members - tried.base)]
        return [tried.tried[s] for s in dict.fromkeys(sets) if s in tried.tried]

    def resume(self, cases: Sequence[Tried]) -> None:
        """Fix again in some cases what was fixed before ``release``; try single effects as well."""
        self.singles = True
        self.fixed = {t.case: self._fixed_before.get(t.case, frozenset()) for t in cases}

    def remains(self, tried: Tried, members: Set) -> bool:
        """Whether some effect would still explain more than chance.

        What every servo has a little of must explain as much as is never left to chance.
        """
        gain, limit = self.remaining_gain(tried, members)
        largest = float(self.seen(tried, members)[0].gain.max())
        return gain > limit or largest > DECISION.decisive_gain

    def exhausted(self, tried: Tried) -> bool:
        """Whether a case that would be searched further has spent its budget; noted down if so.

        The budget is counted in sub-steps of rollouts, so that no answer depends on the machine.
        """
        spent = self.batch.substeps[tried.case] - self._spent_before[tried.case]
        if spent > self.limits.effort * DECISION.search_substeps:
            self.unfinished.add(tried.case)
        return tried.case in self.unfinished

    def remaining_gain(self, tried: Tried, members: Set) -> tuple[float, float]:
        """Largest gain that an effect would still make, and what chance would make.

        What every servo has a little of does not count: it is named only where it is large.
        """
        seen, options = self.seen(tried, members)
        counted = seen.of(np.array([not option.effect.everywhere for option in options]))
        limit = min(counted.threshold(self.level, self.rng), DECISION.decisive_gain)
        return float(counted.gain.max()), limit

    def rebased(self, cases: Sequence[Tried]) -> list[Tried]:
        """Those whose plain servo fits better with the gains that the best single effect found."""
        before = [tried.plain.evidence for tried in cases]
        self.try_all([(tried, tried.base, self.start(tried, tried.base)) for tried in cases])
        better = []
        for tried, old in zip(cases, before, strict=True):
            if tried.plain.evidence > old + self.limits.min_rebase_gain:
                better.append(tried)
                del self._screens[tried.case, tried.base]
        return better

    def strength(self, tried: Tried) -> tuple[float, float]:
        """The plain servo's gain and inertia."""
        first = self.batch.first_signal[tried.case]
        return float(tried.plain.fit.servos.theta[0, 0]), float(self.batch.load[first, 0])


def plain_sets(plain: Fits, bases: Sequence[Set] | None = None) -> list[Tried]:
    """What was tried on each joint before a search: its plain servo, with its model's effects."""
    cases = []
    for j in range(plain.count.size):
        base: Set = bases[j] if bases else frozenset()
        fit = plain.single(j)
        hypothesis = Hypothesis(base, fit, evidence_of(fit, frozenset()))
        cases.append(Tried(j, base, {base: hypothesis}))
    return cases


def _promised(fit: Fits) -> float:
    """Gain in log-likelihood that the next full step of a lone fit promises."""
    total = fit.gram[0].sum(axis=0)
    inverse = np.linalg.pinv(total[1:, 1:], rcond=1e-10, hermitian=True)
    share = float(total[0, 1:] @ inverse @ total[1:, 0]) / max(float(total[0, 0]), 1e-300)
    return -0.5 * float(fit.count[0]) * float(np.log1p(-min(share, 1 - 1e-9)))


def evidence_of(fit: Fits, added: Set) -> float:
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
