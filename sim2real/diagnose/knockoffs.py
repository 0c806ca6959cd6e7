"""Knockoffs: effects that mean nothing, in competition with the real ones.

A knockoff is what a real effect would do, at another time and turned round in random segments. It
is as large, as smooth and as irregular as the real one, and nothing can be behind it: how often one
does as well is how often chance would win (the idea of Barber, Candès, Annals of Statistics 43
(2015) 2055-2085).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.investigate import Finding
from sim2real.diagnose.joint_result import JointResult
from sim2real.diagnose.posterior import Group
from sim2real.diagnose.search import Set
from sim2real.inference.holdout import rms
from sim2real.inference.noise import counting, whitened
from sim2real.servo.holdout import Side, Split, simulated
from sim2real.servo.problem import Servos, variants
from sim2real.servo.screen import Candidate
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

COPIES = 100
"""Knockoffs of each effect: the least share of wrong names that can be seen is one in so many."""
FLOOR_COPIES = 40
"""Knockoffs of each start of each effect, for all folds together."""
_AWAY_S, _SEGMENT_S, _TURN_S = 2.0, (1.5, 4.0), 0.25


@dataclass(frozen=True)
class Directions:
    """One fit of one joint, and what it could be changed by, recording by recording.

    Attributes:
        residual: Simulated minus measured angle in rad, 0 where none was measured, (T,) each.
        taken: Changes of the angle by the free parameters, in rad a unit, (T, F) each.
        effects: Changes of the angle by the starts of all candidates, in rad, (T, S) each.
        candidate: Index of each start's candidate, shape (S,).
    """

    residual: tuple[Array, ...]
    taken: tuple[Array, ...]
    effects: tuple[Array, ...]
    candidate: NDArray[np.intp]


def directions(
    traces: Sequence[Trace], servo: Servos, candidates: Sequence[Candidate] = ()
) -> Directions:
    """Simulate a servo, and it with a little more of everything.

    Args:
        traces: The joint's recordings.
        servo: One servo.
        candidates: The effects.
    """
    own = variants(servo)
    free, scale = own.theta[0], own.scale[0, 1:]
    starts = [_with(free[0], c, start) for c in candidates for start in c.starts]
    rows = np.vstack([free, *(row[None] for row in starts)])
    F = scale.size
    residual, taken, effects = [], [], []
    for trace in traces:
        angle = simulated(trace, rows)
        change = (angle[1:] - angle[0]).T
        residual.append(np.where(trace.used, angle[0] - trace.position, 0.0))
        taken.append(change[:, :F] * scale)
        effects.append(change[:, F:])
    label = np.repeat(np.arange(len(candidates)), [len(c.starts) for c in candidates]).astype(int)
    return Directions(tuple(residual), tuple(taken), tuple(effects), label)


def _with(row: Array, candidate: Candidate, start: Array) -> Array:
    changed = row.copy()
    changed[candidate.columns] = start
    return changed


@dataclass(frozen=True)
class Contest:
    """Gains in log-likelihood by real effects and by knockoffs, from the same fit.

    Attributes:
        real: Of every effect, its best start, shape (C,).
        knockoffs: Of the knockoffs of every effect, likewise, shape (COPIES, C).
    """

    real: Array
    knockoffs: Array

    def chance(self, effects: Sequence[int]) -> float:
        """Probability that a knockoff does as well as the best of some effects: (b + 1) / (n + 1).

        Source: Phipson, Smyth, Statistical Applications in Genetics and Molecular Biology 9 (2010)
        article 39.
        """
        beaten = int((self.knockoffs >= self.real[list(effects)].max()).sum())
        return (beaten + 1) / (self.knockoffs.size + 1)


def false_discovery_rate(chances: Sequence[float], considered: int) -> float:
    """Expected share of wrong ones among the effects that were accepted.

    Of ``considered`` effects that mean nothing, ``considered * p`` would have done as well as the
    weakest accepted one, whose chance is ``p``; divided by the number accepted this is the share.
    Source: Storey, Journal of the Royal Statistical Society B 64 (2002) 479-498, equation 6, with
    none of the effects taken for real beforehand. 0 where nothing was accepted.

    Args:
        chances: For each accepted effect, the probability that a knockoff does as well.
        considered: How many effects, of all joints, could have been accepted.
    """
    if not chances:
        return 0.0
    return min(1.0, considered * max(chances) / len(chances))


def contest(
    traces: Sequence[Trace],
    given: Directions,
    autoregression: Array,
    rng: np.random.Generator,
    copies: int = COPIES,
) -> Contest:
    """Let real effects and knockoffs compete for what a fit leaves, on the terms of ``screen``.

    Args:
        traces: The joint's recordings.
        given: A fit without the effect that is to be judged, and how effects would change it.
        autoregression: Noise model of the fit, shape (lags,).
        rng: For the knockoffs.
        copies: Knockoffs of each effect.
    """
    counts = [counting(trace.used, autoregression.size) for trace in traces]

    def white(parts: Sequence[Array]) -> list[Array]:
        return [whitened(part, autoregression, axis=0) for part in parts]

    def counted(parts: Sequence[Array]) -> Array:
        return np.concatenate([part[c] for part, c in zip(parts, counts, strict=True)])

    # A delay and a slow change of sign pass the noise model: whitening once is enough.
    effects = white(given.effects)
    taken, _ = np.linalg.qr(counted(white(given.taken)))
    left = counted(white(given.residual))
    left = left - taken @ (taken.T @ left)
    real = _gains(counted(effects), taken, left, given.candidate)
    drawn = []
    for _ in range(copies):
        knockoff = [meaningless(x, trace.t, rng) for x, trace in zip(effects, traces, strict=True)]
        drawn.append(_gains(counted(knockoff), taken, left, given.candidate))
    return Contest(real, np.array(drawn))


def meaningless(response: Array, t: Array, rng: np.random.Generator) -> Array:
    """What effects do (T, S), some seconds later and turned round in random segments.

    The delay alone would not do: of a command that repeats itself, an effect does the same again.
    """
    step = float(np.median(np.diff(t)))
    away = max(1, min(round(_AWAY_S / step), t.size // 4))
    delay = int(rng.integers(away, max(t.size - away, away + 1)))
    cuts = t[0] + np.cumsum(rng.uniform(*_SEGMENT_S, size=int((t[-1] - t[0]) / _SEGMENT_S[0]) + 1))
    # It turns round where the end of the recording comes to meet its start, too: no jumps.
    cuts = np.sort(np.append(cuts, t[min(delay, t.size - 1)]))
    segment = np.searchsorted(cuts, t)
    nearest = np.abs(t[:, None] - cuts[None]).min(axis=1)
    sign = rng.choice([-1.0, 1.0], size=cuts.size + 1)[segment]
    weight = sign * np.minimum(1.0, nearest / _TURN_S)
    return np.asarray(np.roll(response, delay, axis=0) * weight[:, None])


def _gains(columns: Array, taken: Array, left: Array, candidate: NDArray[np.intp]) -> Array:
    """Gain in log-likelihood of each candidate's best start, their strength free but not its sign.

    See ``Screen.gain``; ``columns`` (N, S), ``taken`` orthonormal (N, F), ``left`` (N,).
    """
    share = _drop(columns, taken, np.maximum(-(left @ columns), 0.0)) / (left @ left)
    gain = -0.5 * left.size * np.log1p(-np.minimum(share, 1 - 1e-9))
    best = np.zeros(int(candidate.max()) + 1)
    np.maximum.at(best, candidate, gain)
    return best


def _drop(columns: Array, taken: Array, along: Array) -> Array:
    """How far each column lowers a sum of squares beside what is taken, shape (S,)."""
    cross = taken.T @ columns
    norm2 = np.einsum("ns,ns->s", columns, columns)
    seen2 = norm2 - np.einsum("fs,fs->s", cross, cross)
    there = seen2 > 1e-6 * norm2 + 1e-30
    return np.where(there, along**2 / np.maximum(seen2, 1e-300), 0.0)


def false_discovery_of(joints: Sequence[JointResult], rng: np.random.Generator) -> float:
    """Expected share of wrong ones among the effects that are named on a robot's joints.

    Each named effect is judged against knockoffs of all effects, from the fit that lacks it and has
    the others. What is found on the link or read off the sensor's numbers is no part of this. It
    says how often chance would pass for an effect, not how often one effect passes for another.
    """
    chances, considered = [], 0
    for one in joints:
        finding = one.finding
        considered += len(_judged(finding, finding.tried.base))
        for group in finding.groups:
            if group.probability >= DECISION.named and set(group.members) & finding.best.members:
                chances.append(_chance(one.joint.traces, finding, group, rng))
    return false_discovery_rate(chances, considered)


def _chance(
    traces: Sequence[Trace], finding: Finding, group: Group, rng: np.random.Generator
) -> float:
    tried = finding.tried
    without = finding.best.members - set(group.members)
    if without not in tried.tried:
        without = tried.base
    options = _judged(finding, without)
    fit = tried.tried[without].fit
    moved = directions(traces, fit.servos, options)
    members = [k for k, c in enumerate(options) if c.effect.name in group.members]
    return contest(traces, moved, fit.autoregression[0], rng).chance(members)


def _judged(finding: Finding, effects: Set) -> list[Candidate]:
    """The candidates that may be named: what every servo has a little of only where it is."""
    members = {name for group in finding.groups for name in group.members}
    return [
        option
        for option in finding.search.seen(finding.tried, effects)[1]
        if not option.effect.everywhere or option.effect.name in members
    ]


def best_knockoff(
    traces: Sequence[Trace],
    servo: Servos,
    effects: Sequence[Array],
    folds: Sequence[Split],
    rng: np.random.Generator,
    copies: int = FLOOR_COPIES,
) -> float:
    """Held-out error of the plain servo with the best knockoff, rad.

    In every fold the knockoff that explains most of the fitted side is chosen there, its strength
    and the plain servo's parameters fitted there along with it, to first order, by least squares.

    Args:
        traces: The joint's recordings.
        servo: The plain servo, with its free parameters.
        effects: Changes of its angle by the starts of all effects, (T, S) a recording.
        folds: Its refits.
        rng: For the knockoffs.
        copies: Knockoffs of each start of each effect, for all folds together.
    """
    drawn = [
        [meaningless(x, t.t, rng) for x, t in zip(effects, traces, strict=True)]
        for _ in range(max(copies // len(folds), 4))
    ]
    errors: list[Array] = []
    for fold in folds:
        refitted = replace(servo, theta=fold.theta[None])
        errors += _left_of_best(fold, directions(traces, refitted).taken, drawn)
    return rms(errors)


def _left_of_best(
    fold: Split, bent: Sequence[Array], drawn: Sequence[Sequence[Array]]
) -> list[Array]:
    residual = np.concatenate([one.residual for one in fold.fitted])
    taken = _rows(bent, fold.fitted)
    basis, _ = np.linalg.qr(taken)
    residual = residual - basis @ (basis.T @ residual)
    most, chosen = 0.0, None
    for knockoffs in drawn:
        columns = _rows(knockoffs, fold.fitted)
        drop = _drop(columns, basis, residual @ columns)
        best = int(drop.argmax())
        if drop[best] > most:
            most, chosen = float(drop[best]), (knockoffs, best)
    if chosen is None:
        return [one.residual for one in fold.scored]
    knockoffs, best = chosen
    design = np.column_stack([taken, _rows(knockoffs, fold.fitted)[:, best]])
    size = np.sqrt((design**2).sum(axis=0)) + 1e-300
    before = np.concatenate([one.residual for one in fold.fitted])
    change = np.linalg.lstsq(design / size, -before, rcond=1e-8)[0] / size
    after = []
    for one in fold.scored:
        moved = np.column_stack([_rows(bent, [one]), _rows(knockoffs, [one])[:, best]])
        after.append(one.residual + moved @ change)
    return after


def _rows(columns: Sequence[Array], sides: Sequence[Side]) -> Array:
    """Rows of the samples that are used on one side, shape (N, ...)."""
    return np.concatenate([columns[one.recording][one.trace.used] for one in sides])
