"""Servos with effects, fitted to the joints of a batch: the plain one, and what a search asks."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.screening import (
    BRANCH_COLUMNS,
    SIDE_COLUMNS,
    Candidate,
    Screen,
    as_read,
    candidates,
    own_parameters,
    screen,
    with_effects,
)
from sim2real.effects import named
from sim2real.identification.search import servos_at
from sim2real.identification.servo_problem import (
    Fits,
    Hypothesis,
    Set,
    Tried,
    joined,
    minimise,
    plain_servos,
    stacked,
)
from sim2real.inference.evidence import occam_factor
from sim2real.inference.parameters import kronecker
from sim2real.model import JointModel
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import BASE, COLUMNS, FIRST_COLUMN, TRAINS, joint_row

Job = tuple[Tried, Set, Array]
"""What was tried on a joint, the set of effects to refit, and the parameters to start from."""

_GAIN, _DRIFT = "sensor_gain", "clock_drift"
_GAP = FIRST_COLUMN["backlash"]
_TRAINS = {name: (FIRST_COLUMN[name], 1e-3 * named(name).parameters[0].typical) for name in TRAINS}
"""Columns of the sizes of gear trains, and sizes from which on they are there."""
BLOCKS = 20
"""Blocks of each recording for bootstraps."""


class ServoSearch:
    """What the search asks of the servos of a batch: see ``selection.Problem``.

    Attributes:
        joints: The joints of the batch, by case.
        fixed: By case, effects whose parameters stay as they are until ``release``.
        singles: Whether every effect by itself is still to be tried.
        unfinished: Cases whose search was ended by its budget.
    """

    rivals = 10  # sets that are refitted with nothing fixed
    near = 80.0  # nats by which the evidence of such a set may be behind the best
    hopeless_gain = 1.0  # nats at first sight, below which the best start is not followed
    least_visible = 3.0  # score of an effect, were it there, from which it would be seen
    promise = 6.0  # times the gain that a fit's quadratic model promises

    def __init__(
        self, batch: Batch, joints: Sequence[JointCase], level: float, rng: np.random.Generator
    ) -> None:
        self.batch, self.joints, self.level, self.rng = batch, tuple(joints), level, rng
        self.fixed: dict[int, Set] = {}
        self.singles = True
        self.unfinished: set[int] = set()
        self.spent_before = batch.substeps.copy()
        self._screens: dict[tuple[int, Set], tuple[Screen, list[Candidate]]] = {}

    def try_all(self, jobs: Sequence[Job], *, free: bool = False) -> None:
        """Refit sets of effects, and record them."""
        for (tried, _, _), hypothesis in zip(jobs, self.refit(jobs, free=free), strict=True):
            tried.keep(hypothesis)

    def seen(self, tried: Tried, members: Set) -> tuple[Screen, list[Candidate]]:
        """What every effect that may join a set would explain of what it leaves."""
        self.look([(tried, members)])
        return self._screens[tried.case, members]

    def look(self, pairs: Sequence[tuple[Tried, Set]]) -> None:
        """Screen all other effects from each of these sets; sets of one size share a launch.

        Readings that are sampled slowly are those of the last poll, whose age slips by up to a
        period and jumps back: no drift of a clock is told from that.
        """
        pairs = [pair for pair in pairs if (pair[0].case, pair[1]) not in self._screens]
        new = {(tried.case, members): (tried, members) for tried, members in pairs}
        unknown = {_DRIFT} if self.batch.period > DECISION.change.slow_sampling_s else set[str]()
        lists = [
            [x for x in candidates(s, *self.strength(tried)) if x.effect.name not in unknown]
            for tried, s in new.values()
        ]
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
        starts: list[int] = []
        weakest = most is None and self.remains(tried, members)
        for k, option in enumerate(options):
            mine = np.flatnonzero(seen.candidate == k)
            best = int(mine[seen.gain[mine].argmax()])
            visible = mine[seen.visible[mine] > self.least_visible]
            if most is not None or seen.gain[best] > self.hopeless_gain:
                starts.append(best)
            if most is None:  # branches of an effect's law: fits of their own
                branch = option.branches(seen.start[mine])
                others = mine[(branch != branch[mine == best]).any(axis=1)]
                starts += [int(others[seen.gain[others].argmax()])] if others.size else []
            if weakest and visible.size and not option.effect.everywhere:
                starts.append(int(visible[seen.visible[visible].argmin()]))
        chosen = []
        for index in sorted(dict.fromkeys(starts), key=lambda start: -seen.gain[start])[:most]:
            option = options[seen.candidate[index]]
            theta = tried.tried[members].fit.servos.theta[0].copy()
            theta[option.columns] = option.starts[seen.start[index]]
            chosen.append((option.effect.name, theta))
        return chosen

    def start(self, tried: Tried, members: Set) -> Array:
        """The parameter row of the best set, from which every other is refitted."""
        return np.array(tried.best.fit.servos.theta[0])

    def refit(self, jobs: Sequence[Job], *, free: bool = False) -> list[Hypothesis]:
        """Refit sets of effects from parameter rows; the best of several starts stands for all.

        Starts in different branches of an effect's law and starts with different gaps are fits of
        their own: motion across a gap has many minima. A set is given up where its case has a fit
        that it can't come near. ``free``: nothing is fixed.
        """
        if not jobs:
            return []
        servos = []
        for tried, members, theta in jobs:
            plain, inertia = tried.plain.fit.servos, self.strength(tried)[1]
            fixed: Set = frozenset() if free else self.fixed.get(tried.case, frozenset())
            servos.append(with_effects(plain, members, as_read(theta, members), inertia, fixed))
        rough = minimise(self.batch, stacked(servos), iterations=5, blocks=BLOCKS)
        of = [
            (x.case, s, (*(row[BRANCH_COLUMNS] > 0), *row[SIDE_COLUMNS], row[_GAP]))
            for x, s, row in jobs
        ]
        sets = list(dict.fromkeys(of))
        place = np.array([sets.index(one) for one in of])
        order = np.lexsort((rough.error2, place))
        first = order[np.unique(place[order], return_index=True)[1]]
        fits = [rough.single(k) for k in first]
        top = {tried.case: float(tried.best.fit.loglikelihood[0]) for tried, _, _ in jobs}
        for (case, *_), fit in zip(sets, fits, strict=True):
            top[case] = max(top[case], float(fit.loglikelihood[0]))
        goals = np.array([-np.inf if _GAIN in s else top[case] - self.near for case, s, _ in sets])
        reach = np.array([x.loglikelihood[0] + self.promise * _promised(x) for x in fits])
        left = np.flatnonzero(~rough.converged[first] & (reach > goals))

        def hopeless(places: Index, _: Array, losses: Array, promised: Array) -> Mask:
            reachable = self.promise * promised - losses[places]
            return np.asarray(reachable < goals[left][places])

        if left.size:
            start = rough.servos[first[left]]
            fine = minimise(self.batch, start, iterations=15, blocks=BLOCKS, hopeless=hopeless)
            for n, k in enumerate(left):
                fits[k] = fine.single(n)
        return [
            Hypothesis(members, fits[k], evidence_of(fits[k], members - tried.base))
            for (tried, members, _), k in zip(jobs, place, strict=True)
        ]

    def release(self, cases: Sequence[Tried]) -> None:
        """Refit the most probable sets of each case, and the plain one, with nothing fixed.

        What was fixed was fitted with the most probable set of that time, and favours it.
        """
        fixed = [(t, h) for t in cases if self.fixed.get(t.case) for h in self.compared(t)]
        jobs = [(tried, h.members, h.fit.servos.theta[0]) for tried, h in fixed]
        for (tried, h), refitted in zip(fixed, self.refit(jobs, free=True), strict=True):
            more = float(refitted.fit.loglikelihood[0] - h.fit.loglikelihood[0])
            # All are as free: what freedom costs is the same for each.
            if more > 0:
                tried.tried[h.members] = replace(refitted, evidence=h.evidence + more)
                self._screens.pop((tried.case, h.members), None)

    def compared(self, tried: Tried) -> list[Hypothesis]:
        """The sets that are compared: the best, the best without each effect, its rivals."""
        best = tried.best
        scaled, least = _GAIN in best.members, best.evidence - self.near
        near = sorted(tried.tried.values(), key=lambda h: -h.evidence)[: self.rivals]
        sets = [h.members for h in near if h.evidence > least or (_GAIN in h.members) != scaled]
        sets += [tried.base, *(best.members - {e} for e in best.members - tried.base)]
        return [tried.tried[s] for s in dict.fromkeys(sets) if s in tried.tried]

    def remains(self, tried: Tried, members: Set) -> bool:
        """Whether an effect explains more than chance, or a nuisance more than is ever chance."""
        gain, limit = self.remaining_gain(tried, members)
        largest = float(self.seen(tried, members)[0].gain.max())
        return gain > limit or largest > DECISION.decisive_gain

    def remaining_gain(self, tried: Tried, members: Set) -> tuple[float, float]:
        """Largest gain that an effect, but no nuisance, would still make, and that of chance."""
        seen, options = self.seen(tried, members)
        counted = np.array([not option.effect.everywhere for option in options])[seen.candidate]
        limit = min(seen.threshold(self.level, self.rng, starts=counted), DECISION.decisive_gain)
        return float(seen.gain[counted].max()), limit

    def exhausted(self, tried: Tried) -> bool:
        """Whether a case that would be searched further has spent its budget; noted down if so.

        The budget is counted in sub-steps of rollouts, so that no answer depends on the machine.
        """
        spent = self.batch.substeps[tried.case] - self.spent_before[tried.case]
        if spent > max(joint.effort for joint in self.joints) * DECISION.search_substeps:
            self.unfinished.add(tried.case)
        return tried.case in self.unfinished

    def strength(self, tried: Tried) -> tuple[float, float]:
        """The plain servo's gain and inertia."""
        kp = float(tried.plain.fit.servos.theta[0, 0])
        return kp, float(self.batch.inertia[tried.case])


def plain_sets(plain: Fits, bases: Sequence[Set] | None = None) -> list[Tried]:
    """What was tried on each joint before a search: its plain servo, with its model's effects."""
    cases = []
    for j in range(plain.count.size):
        base: Set = bases[j] if bases else frozenset()
        fit = plain.single(j)
        cases.append(Tried(j, base, {base: Hypothesis(base, fit, evidence_of(fit, frozenset()))}))
    return cases


def _promised(fit: Fits) -> float:
    """Gain in log-likelihood that the next full step of a lone fit promises, 0 if it diverges."""
    total = fit.gram[0].sum(axis=0)
    if not np.isfinite(total).all():
        return 0.0
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


def baselines(
    batch: Batch,
    given: Sequence[JointModel | None] = (),
    *,
    candidates: int = 256,
    refined: int = 3,
) -> Fits:
    """Fit the plain servo to every joint of a batch, with no guess by hand.

    Starts are ``candidates`` servos, and ``given`` models, one a joint, where there are any.
    """
    J, K, inertia = batch.inertia.size, candidates, batch.inertia
    theta = np.zeros((J, K, len(COLUMNS)))
    theta[:, :, :3] = servos_at(kronecker(K, 3, np.random.default_rng(0)), inertia[:, None])
    joint = np.repeat(np.arange(J, dtype=np.int32), K)
    problems = Problems(joint, theta.reshape(J * K, 1, -1), np.zeros((J * K, 1)))
    white = np.zeros((J * K, batch.lags))
    looks = batch.evaluate(problems, autoregression=white, rough=True)
    best = np.argsort(looks.square[:, 0].reshape(J, K), axis=1)[:, :6]
    starts = np.take_along_axis(theta, best[:, :, None], axis=1)
    if any(given):
        known = starts[:, :1].copy()
        for j, model in enumerate(given):
            if model is not None:
                known[j] = joint_row(model, None)
        starts = np.concatenate([starts, known], axis=1)
        starts[:, :, len(BASE) :] = known[:, :, len(BASE) :]
    K = starts.shape[1]
    joint, rows = np.repeat(np.arange(J), K), starts.reshape(J * K, -1)
    servos = plain_servos(joint, rows, inertia[joint], batch.period, free_line=True)
    rough = minimise(batch, servos, iterations=12, white=True)
    order = np.argsort(rough.error2.reshape(J, K), axis=1)[:, :refined]
    pick = (np.arange(J)[:, None] * K + order).ravel()
    fine = minimise(batch, rough[pick].servos, iterations=12, blocks=BLOCKS)
    best = fine.error2.reshape(J, -1).argmin(axis=1)
    return fine[np.arange(J) * order.shape[1] + best]


def plain_again(batch: Batch, known: Sequence[Tried]) -> Fits:
    """Fit the plain servos that are known of such a batch, one a joint, to this one."""
    servos = []
    for j, tried in enumerate(known):
        plain, inertia = tried.plain.fit.servos, float(batch.inertia[j])
        servo = with_effects(plain, tried.base, plain.theta[0], inertia, tried.base)
        servos.append(servo.of_joints([j]))
    return minimise(batch, stacked(servos), iterations=12, blocks=BLOCKS)
