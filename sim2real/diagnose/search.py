"""Which effects does each joint need? The servo's side of the search of ``inference.selection``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.nuisances import with_nuisances
from sim2real.effects import named
from sim2real.inference import selection
from sim2real.inference.evidence import occam_factor
from sim2real.model import JointModel
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import BASE, COLUMNS, FIRST_EFFECT_COLUMN, joint_row
from sim2real.servo.problem import Fits, Servos, joined, minimise, plain_servos, stacked
from sim2real.servo.screen import FITTED, Candidate, Screen, candidate, candidates, screen
from sim2real.servo.start import DAMPING_RATIO, FREQUENCY_RAD_S, LATENCY_S

Array = NDArray[np.float64]
Set = frozenset[str]
Hypothesis = selection.Hypothesis[Fits]
Found = selection.Ledger[Fits]
"""Every set of effects that was tried on one joint."""

LOG_PRIOR = float(np.log(DECISION.missing_share / len(FITTED)))
"""Logarithm of the prior odds of each effect."""
BREADTH = selection.Breadth()
BLOCKS = 20
"""Blocks of each recording for bootstraps."""
_CANDIDATES = 256
_REFINED = 3
_BETTER = 1.0
_SINGLES, _HOPELESS = 24, 1.0
"""Starts of single effects that are followed, and the gain at first sight below which none is."""


def baselines(batch: Batch, given: Sequence[JointModel | None] = ()) -> Fits:
    """Fit the plain servo to every joint of a batch, with no guess by hand.

    Args:
        batch: The recordings.
        given: Models to start from as well, one a joint, where there are any.
    """
    J = batch.recordings.size
    points = qmc.Sobol(3, seed=0).random(_CANDIDATES)
    ranges = np.array([np.log(FREQUENCY_RAD_S), np.log(DAMPING_RATIO), LATENCY_S])
    scaled = ranges[:, 0] + points * np.diff(ranges, axis=1).T
    frequency, damping = np.exp(scaled[:, :2]).T
    inertia = batch.load[batch.first_signal, 0]
    theta = np.zeros((J, _CANDIDATES, len(COLUMNS)))
    theta[:, :, 0] = inertia[:, None] * frequency**2
    theta[:, :, 1] = inertia[:, None] * 2 * damping * frequency
    theta[:, :, 2] = scaled[:, 2]
    joint = np.repeat(np.arange(J, dtype=np.int32), _CANDIDATES)
    rows = theta.reshape(-1, 1, len(COLUMNS))
    white = np.zeros((joint.size, batch.lags))
    seen = batch.evaluate(Problems(joint, rows, np.zeros(rows.shape[:2])), autoregression=white)
    error2 = seen.square[:, 0].reshape(J, _CANDIDATES)
    best = np.argsort(error2, axis=1)[:, :6]
    starts = np.take_along_axis(theta, best[:, :, None], axis=1)
    if any(given):
        known = starts[:, :1].copy()
        for j, model in enumerate(given):
            if model is not None:
                known[j] = joint_row(model, None)
        starts = np.concatenate([starts, known], axis=1)
        starts[:, :, len(BASE) :] = known[:, :, len(BASE) :]
    K = starts.shape[1]
    starting = np.repeat(np.arange(J), K)
    begin = starts.reshape(J * K, -1)
    many = plain_servos(starting, begin, inertia[starting], batch.period, free_line=True)
    rough = minimise(batch, many, iterations=12, white=True)
    order = np.argsort(rough.error2.reshape(J, K), axis=1)[:, :_REFINED]
    pick = (np.arange(J)[:, None] * K + order).ravel()
    fine = minimise(batch, rough[pick].servos, iterations=12, blocks=BLOCKS)
    best = fine.error2.reshape(J, -1).argmin(axis=1)
    return fine[np.arange(J) * order.shape[1] + best]


def search(
    batch: Batch,
    plain: Fits,
    *,
    level: float,
    rng: np.random.Generator,
    noise: Sequence[float] | None = None,
    bases: Sequence[Set] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[list[Found], ServoSearch]:
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
    ledgers: list[Found] = []
    for j in range(plain.count.size):
        base: Set = bases[j] if bases else frozenset()
        fit = _one(plain, j)
        ledgers.append(Found(j, base))
        ledgers[-1].keep(Hypothesis(base, fit, _evidence(fit, frozenset())))
    problem = ServoSearch(batch, level, rng)
    if noise is not None:
        ledgers = with_nuisances(problem, ledgers, noise)
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

    def seen(self, ledger: Found, members: Set) -> tuple[Screen, list[Candidate]]:
        """What every effect that may join a set would explain of what it leaves."""
        self.look([(ledger, members)])
        return self._seen[ledger.case, members]

    def look(self, pairs: Sequence[tuple[Found, Set]]) -> None:
        """Screen all other effects from each of these sets; sets of one size share a launch."""
        new = {(one.case, s): (one, s) for one, s in pairs if (one.case, s) not in self._seen}
        sizes = {key: one.tried[s].fit.gram.shape[-1] for key, (one, s) in new.items()}
        for size in sorted(set(sizes.values())):
            some = [x for key, x in new.items() if sizes[key] == size]
            fits = joined([one.tried[s].fit for one, s in some])
            # A finding may have been moved to a place in another batch.
            joint = np.array([one.case for one, _ in some], dtype=np.int32)
            fits = replace(fits, servos=replace(fits.servos, joint=joint))
            lists = [candidates(s, *self.strength(one)) for one, s in some]
            screens = screen(self.batch, fits, lists, blocks=BLOCKS)
            for (one, s), seen, given in zip(some, screens, lists, strict=True):
                self._seen[one.case, s] = seen, given

    def additions(self, ledger: Found, members: Set, most: int | None) -> list[tuple[str, Array]]:
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

    def start(self, ledger: Found, members: Set, of: Set | None = None) -> Array:
        """The parameter row of a set, or of the best one."""
        known = ledger.best if of is None else ledger.tried[of]
        return np.array(known.fit.servos.theta[0])

    def refit(self, jobs: Sequence[tuple[Found, Set, Array]]) -> list[Hypothesis]:
        """Refit sets of effects from parameter rows; the best of several starts stands for all."""
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
        fits = {key: _one(fine, n) for n, key in enumerate(best)}
        return [
            Hypothesis(s, fits[one.case, s], _evidence(fits[one.case, s], s - one.base))
            for one, s, _ in jobs
        ]

    def remains(self, ledger: Found, members: Set) -> bool:
        """Whether some effect would still explain more than chance.

        What every servo has a little of does not count: it is named only where it is large.
        """
        gain, limit = self.left(ledger, members)
        return gain > limit

    def left(self, ledger: Found, members: Set) -> tuple[float, float]:
        """Largest gain that an effect would still make, and what chance would make."""
        seen, given = self.seen(ledger, members)
        counted = seen.of(np.array([not c.effect.everywhere for c in given]))
        limit = min(counted.threshold(self.level, self.rng), DECISION.surely)
        return float(counted.gain.max()), limit

    def rebased(self, ledgers: Sequence[Found]) -> list[Found]:
        """Those whose plain servo fits better with the gains that the best single effect found."""
        before = [one.plain.evidence for one in ledgers]
        jobs = [(one, one.base, self.start(one, one.base)) for one in ledgers]
        for one, found in zip(ledgers, self.refit(jobs), strict=True):
            one.keep(found)
        better = [
            one
            for one, old in zip(ledgers, before, strict=True)
            if one.plain.evidence > old + _BETTER
        ]
        for one in better:
            del self._seen[one.case, cast(Set, one.base)]
        return better

    def screened(self, places: Sequence[Hypothesis], lists: list[list[Candidate]]) -> list[Screen]:
        """What these candidates would explain of what each hypothesis leaves."""
        found: dict[int, Screen] = {}
        widths = [h.fit.servos.columns.shape[1] for h in places]
        for width in sorted(set(widths)):
            some = [k for k, w in enumerate(widths) if w == width]
            fits = joined([places[k].fit for k in some])
            seen = screen(self.batch, fits, [lists[k] for k in some], blocks=BLOCKS)
            found.update(zip(some, seen, strict=True))
        return [found[k] for k in range(len(places))]

    def strength(self, ledger: Found) -> tuple[float, float]:
        """The plain servo's gain and inertia."""
        first = self.batch.first_signal[ledger.case]
        return float(ledger.plain.fit.servos.theta[0, 0]), float(self.batch.load[first, 0])


def with_effects(
    plain: Servos,
    effects: Set,
    theta: Array,
    kp: float,
    inertia: float,
    held: Set = frozenset(),
) -> Servos:
    """A servo whose gains, latency and parameters of effects are free.

    Args:
        plain: The plain servo, of one row; its gains, latency and line are free.
        effects: Effects whose parameters are free; others of ``theta`` are dropped.
        theta: Where to start, shape (P,).
        kp: Gain that the effects are scaled to, N m/rad.
        inertia: Inertia that they are scaled to, kg m2.
        held: Those of the effects that stay as they are in ``theta``.
    """
    given = [candidate(named(name), kp, inertia) for name in sorted(effects) if named(name).fitted]
    row = np.zeros_like(theta)
    row[:FIRST_EFFECT_COLUMN] = theta[:FIRST_EFFECT_COLUMN]
    for option in given:
        row[option.columns] = theta[option.columns]
    given = [option for option in given if option.effect.name not in held]
    own = _own(plain)
    free = (
        np.concatenate([getattr(plain, field)[0, own], *(getattr(c, field) for c in given)])[None]
        for field in ("columns", "unit", "low", "high")
    )
    return Servos(plain.joint, row[None], *free)


def _own(servos: Servos) -> NDArray[np.bool_]:
    """Which of one servo's free parameters are no effect's, shape (F,)."""
    columns = servos.columns[0]
    return np.asarray((columns >= 0) & (columns < FIRST_EFFECT_COLUMN))


def _one(fits: Fits, n: int) -> Fits:
    """One fit without columns that hold no parameter."""
    one = fits[np.array([n])]
    return one.wide(int(one.servos.free.sum()))


def _evidence(fit: Fits, added: Set) -> float:
    """Laplace's approximation of the evidence of effects, with their prior."""
    information = fit.gram.sum(axis=1)[:, 1:, 1:] / (fit.error2 / fit.count)[:, None, None]
    occam = occam_factor(information, DECISION.prior_sd, nuisance=int(_own(fit.servos).sum()))
    return float(fit.loglikelihood[0] - occam[0]) + len(added) * LOG_PRIOR
