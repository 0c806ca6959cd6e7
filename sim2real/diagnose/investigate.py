"""From recordings of any number of robots to what each joint is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.arrival import NOTICED, Link, Listened, links
from sim2real.diagnose.arrival_response import Residual
from sim2real.diagnose.candidates import REFITTED, RIPPLE, ROUNDING
from sim2real.diagnose.posterior import Group, Posterior, posterior
from sim2real.diagnose.search import (
    LOG_PRIOR,
    Book,
    Hypothesis,
    Set,
    baselines,
    joined,
    remains,
    search,
)
from sim2real.diagnose.unknown import Unknown, excess, residual_angles, unknown
from sim2real.effects import named
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

FALSE_ALARMS = 0.01
"""Share of robots with nothing missing that are called mismatched."""
SMALLEST_RIPPLE = 0.7
"""Ripple below so many standard deviations of the noise is no finding."""
STRUCTURED = 1.3
"""Excess from which a residual is more than noise and slow wander."""
EXPLAINED = 0.5
"""Share of the excess that named effects must explain, or the cause is not in the catalogue."""
_NOTHING_LEFT = 1.15
_NAMELESS_COST = 10.0
_SOFTNESS = 5.0
_FEW = 2
"""Effects that one joint may well miss together."""
_LAW_AT_FAULT, _CROWDED = 0.15, 0.6
"""Highest probability of effects beyond these, or beside one that leaves structure behind; and of
the greatest of such a crowd. So many were there on the first sealed set, which is spent: 10 of 63
and 20 of 32 (``reports/missing_physics/T1.json``)."""
_TIE, _SHOWING = 5.0, 4.0
_DEAFENING = 20.0
"""Excess from which nothing can be heard of single set-points."""
_CERTAIN, _SHARED = 0.95, 0.9
MOST_CERTAIN = 0.96
"""No effect is more probable: so many of those that looked certain were there, on cases made for it
(``datasets/concealed``, seed 1), where laws are approximations."""


@dataclass(frozen=True)
class Finding:
    """What one joint is missing.

    Attributes:
        book: Every set of effects that was tried.
        posterior: Their probabilities.
        best: The likeliest set.
        mismatch: Whether something is missing at all.
        left: Whether the likeliest set leaves something.
        groups: What is missing, likeliest first.
        nameless: What could be missing without a name.
        unknown: Probability that what is missing is not in the catalogue.
        excess: Energy of the best set's residual beyond noise, in variances of the noise.
        step_rad: Step of an angle sensor that is coarser than stated, or None.
        link: What is uneven on the link, or None.
    """

    book: Book
    posterior: Posterior
    best: Hypothesis
    mismatch: bool
    left: bool
    groups: tuple[Group, ...]
    nameless: Unknown
    unknown: float
    excess: float
    step_rad: float | None
    link: Link | None = None


def investigate(
    batch: Batch,
    joints: Sequence[Sequence[Trace]],
    robots: Sequence[Sequence[int]],
    *,
    rng: np.random.Generator,
    steps: Sequence[float | None] | None = None,
    models: Array | None = None,
    bases: Sequence[Set] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Finding]:
    """Find what each joint is missing.

    Args:
        batch: The recordings, joint by joint.
        joints: The same, as traces.
        robots: Which joints of the batch share a supply and a link.
        rng: For bootstraps.
        steps: Steps of angle sensors found coarser than stated, one a joint.
        models: Parameter rows of given models, shape (joints, P), NaN where there is none.
        bases: Effects that the given models have.
        progress: Called with the share that is done.
    """
    known = _Known(joints, robots, steps, models, bases)
    findings = _pass(batch, known, rng, lambda share: progress(0.7 * share))
    # Where structure stays, it is no sensor's noise: the noise model must then be free.
    again = [j for j, finding in enumerate(findings) if finding.excess > STRUCTURED]
    if again:
        some = known.of(again)
        free = Batch(some.joints, batch.device, batch.threads, bounded=False)
        second = _pass(free, some, rng, lambda share: progress(0.7 + 0.3 * share))
        for j, finding in zip(again, second, strict=True):
            mismatch = finding.mismatch or findings[j].mismatch
            findings[j] = replace(_placed(finding, j), mismatch=mismatch)
    findings = _with_links(batch, known, findings)
    progress(1.0)
    return findings


def _placed(finding: Finding, joint: int) -> Finding:
    """A finding of another batch, its fits those of this joint of the whole one."""
    book = finding.book
    at = np.array([joint], dtype=np.int32)
    tried = {
        effects: replace(h, fit=replace(h.fit, servos=replace(h.fit.servos, joint=at)))
        for effects, h in book.tried.items()
    }
    moved = replace(book, joint=joint, tried=tried)
    return replace(finding, book=moved, best=tried[finding.best.effects])


def _with_links(batch: Batch, known: _Known, findings: Sequence[Finding]) -> list[Finding]:
    """Findings that also say what is uneven on the link.

    Set-points that come unevenly can pass for a weak effect. So a robot is heard twice: with what
    was found on its joints and without.
    """
    plain = [finding.book.plain for finding in findings]
    best = [finding.best for finding in findings]
    robots = [[j for j in robot if findings[j].excess < _DEAFENING] for robot in known.robots]
    robots = [robot for robot in robots if robot]
    both = links(
        [_listened(batch, known, robot, some) for some in (plain, best) for robot in robots]
    )
    alone, beside = both[: len(robots)], both[len(robots) :]
    heard = list(findings)
    for robot, without, withal in zip(robots, alone, beside, strict=True):
        if not _heard_by_all(without, withal, [findings[j] for j in robot]):
            continue
        for k, j in enumerate(robot):
            finding = findings[j]
            known_gain = finding.best.evidence - finding.book.plain.evidence
            instead = without.shares[k] > withal.shares[k] + known_gain - _TIE
            link = without if instead and without.gain >= NOTICED else withal
            if link.gain < NOTICED:
                continue
            sure = min(float(1 / (1 + np.exp(-link.gain / 2))), MOST_CERTAIN)
            group = Group((link.effect,), sure, 1.0)
            rest = () if instead else finding.groups
            explains = link.shares[k] > finding.nameless.smooth.evidence(
                float(finding.best.fit.count[0])
            )
            heard[j] = replace(
                finding,
                mismatch=True,
                best=finding.book.plain if instead else finding.best,
                left=finding.left and not explains,
                unknown=0.0 if explains else finding.unknown,
                groups=(*(r for r in rest if r.probability > 0), group),
                link=link,
            )
    return heard


def _heard_by_all(without: Link, withal: Link, findings: Sequence[Finding]) -> bool:
    """Whether a link is uneven on more than the joints whose own effects could pass for it."""
    if max(without.gain, withal.gain) < NOTICED:
        return False
    showing = [share > _SHOWING for share in withal.shares]
    free = [shows for shows, f in zip(showing, findings, strict=True) if not f.groups]
    if free and not any(free):
        return False
    return len(showing) < 2 or sum(showing) > 1


def _listened(
    batch: Batch, known: _Known, robot: Sequence[int], fits: Sequence[Hypothesis]
) -> Listened:
    residuals = residual_angles(batch, joined([fits[j].fit for j in robot]))
    joints = []
    for j, residual in zip(robot, residuals, strict=True):
        kp, kd, latency = (float(x) for x in fits[j].fit.servos.theta[0, :3])
        joints.append(
            tuple(
                Residual(
                    t.t,
                    t.command,
                    t.used,
                    residual[r, : t.t.size],
                    kp,
                    kd,
                    latency,
                    t.load.inertia_kgm2,
                    t.load.gravity_Nm,
                )
                for r, t in enumerate(known.joints[j])
            )
        )
    return Listened(tuple(joints), batch.lags, batch.least_gain)


@dataclass(frozen=True)
class _Known:
    """What is given, joint by joint."""

    joints: Sequence[Sequence[Trace]]
    robots: Sequence[Sequence[int]]
    steps: Sequence[float | None] | None
    models: Array | None
    bases: Sequence[Set] | None

    def of(self, some: Sequence[int]) -> _Known:
        """What is given of some of the joints."""
        place = {j: k for k, j in enumerate(some)}
        robots = [[place[j] for j in robot if j in place] for robot in self.robots]
        return _Known(
            [self.joints[j] for j in some],
            [robot for robot in robots if robot],
            None if self.steps is None else [self.steps[j] for j in some],
            None if self.models is None else self.models[list(some)],
            None if self.bases is None else [self.bases[j] for j in some],
        )


def _pass(
    batch: Batch,
    known: _Known,
    rng: np.random.Generator,
    progress: Callable[[float], None],
) -> list[Finding]:
    levels = np.empty(len(known.joints))
    for robot in known.robots:
        levels[list(robot)] = FALSE_ALARMS / len(robot)
    plain = baselines(batch, known.models)
    progress(0.1)
    books = search(
        batch,
        plain,
        level=float(levels.min()),
        rng=rng,
        bases=known.bases,
        progress=lambda share: progress(0.1 + 0.8 * share),
    )
    posteriors = _posteriors(books, known.robots, rng)
    best = [book.tried[p.sets[0]] for book, p in zip(books, posteriors, strict=True)]
    plain = joined([book.plain.fit for book in books])
    nameless = unknown(batch, known.joints, known.robots, plain)
    after = _excesses(batch, known.joints, best)
    progress(1.0)
    return [
        _finding(
            books[j],
            posteriors[j],
            nameless[j],
            after[j],
            float(levels[j]),
            known.steps[j] if known.steps else None,
            rng,
        )
        for j in range(len(known.joints))
    ]


def _finding(
    book: Book,
    after: Posterior,
    nameless: Unknown,
    excess_after: float,
    level: float,
    step: float | None,
    rng: np.random.Generator,
) -> Finding:
    best = book.tried[after.sets[0]]
    strange = _strangeness(book, best, nameless, excess_after)
    groups = tuple(g for g in after.groups(book.base) if not _trifle(best, g))
    left = excess_after > STRUCTURED or (
        best.effects in book.screens and remains(book, best.effects, level, rng)
    )
    groups = _lesser(book, groups, 1 if excess_after > STRUCTURED else _FEW)
    mismatch = (
        remains(book, book.base, level, rng)
        or any(group.probability > _CERTAIN for group in groups)
        or nameless.excess > STRUCTURED
        or strange > EXPLAINED
    )
    groups = tuple(
        replace(g, probability=min(g.probability, MOST_CERTAIN) * (1 - strange)) for g in groups
    )
    groups = tuple(sorted(groups, key=lambda g: -g.probability)) if mismatch else ()
    if step is not None:
        groups = (*groups, Group((ROUNDING,), MOST_CERTAIN, 1.0))
    return Finding(
        book,
        after,
        best,
        mismatch or step is not None,
        mismatch and (left or strange > EXPLAINED),
        groups,
        nameless,
        strange if mismatch else 0.0,
        excess_after,
        step,
    )


def _strangeness(book: Book, best: Hypothesis, nameless: Unknown, excess_after: float) -> float:
    """Probability that what is missing is not in the catalogue."""
    known = best.evidence - book.plain.evidence
    ahead = nameless.smooth.evidence(float(best.fit.count[0])) - known - _NAMELESS_COST
    strange = float(1 / (1 + np.exp(-np.clip(ahead / _SOFTNESS, -50, 50))))
    if nameless.excess > STRUCTURED:
        if excess_after < _NOTHING_LEFT:
            return 0.0
        explained = (nameless.excess - excess_after) / (nameless.excess - 1)
        if explained < EXPLAINED:
            strange = max(strange, _CERTAIN)
    return strange


def _lesser(book: Book, groups: tuple[Group, ...], sure: int) -> tuple[Group, ...]:
    """Doubt all effects but the greatest: where a law does not fit, others make up for it."""

    def alone(group: Group) -> float:
        sets = [book.base | {e} for e in group.members]
        return max((book.tried[s].evidence for s in sets if s in book.tried), default=-np.inf)

    order = sorted(groups, key=alone, reverse=True)
    crowd = len(order) > _FEW

    def doubted(k: int, group: Group) -> Group:
        most = _CROWDED if crowd and k == 0 else _LAW_AT_FAULT
        sure_of_it = k < (0 if crowd else sure)
        return group if sure_of_it else replace(group, probability=min(group.probability, most))

    return tuple(doubted(k, group) for k, group in enumerate(order))


def _trifle(best: Hypothesis, group: Group) -> bool:
    """Whether a group is no more than the ripple that every gear train has."""
    if group.members[0] != RIPPLE:
        return False
    theta = best.fit.servos.theta[0]
    noise = np.sqrt(best.fit.error2[0] / best.fit.count[0])
    return bool(theta[COLUMNS.index(f"{RIPPLE}.torque_Nm")] / theta[0] < SMALLEST_RIPPLE * noise)


def _posteriors(
    books: Sequence[Book], robots: Sequence[Sequence[int]], rng: np.random.Generator
) -> list[Posterior]:
    alone = [posterior(book, rng) for book in books]
    after = list(alone)
    for robot in robots:
        for j in robot:
            odds = _shared_odds([alone[i] for i in robot if i != j])
            after[j] = posterior(books[j], rng, odds)
    return after


def _shared_odds(others: Sequence[Posterior]) -> dict[str, float]:
    """What the other joints say of the effects of the supply and the link, as log odds."""
    odds = {}
    for effect in REFITTED:
        if named(effect.name).component == "joint" or not others:
            continue
        absent = float(np.prod([1 - _SHARED * p.inclusion(effect.name) for p in others]))
        before = np.exp(LOG_PRIOR)
        after = absent * before + (1 - absent) * _SHARED / (1 - _SHARED)
        odds[effect.name] = float(np.log(after / before))
    return odds


def _excesses(
    batch: Batch, joints: Sequence[Sequence[Trace]], best: Sequence[Hypothesis]
) -> list[float]:
    fits = joined([h.fit for h in best])
    residuals = residual_angles(batch, fits)
    return [
        excess(residuals[j], traces, batch, float(np.sqrt(h.fit.error2[0] / h.fit.count[0])))
        for j, (traces, h) in enumerate(zip(joints, best, strict=True))
    ]
