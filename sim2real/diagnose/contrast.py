"""What has changed, given how recordings of an unchanged servo differ among themselves.

Every servo lacks some physics, and what it lacks looks different in each recording: an effect that
is freed in one reference alone gains something there, though nothing has changed. What it gains in
each of the references is the scale by which its gain in the case is judged (the dispersion of
quasi-likelihood: McCullagh, Nelder, Generalized Linear Models, 2nd ed., Chapman & Hall, 1989, ch.
9). There are few references, so each effect borrows from the others, and its score has Student's
tails.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from sim2real.diagnose.candidates import RIPPLE
from sim2real.diagnose.investigate import EXPLAINED, MOST_CERTAIN
from sim2real.diagnose.pool import Pool
from sim2real.diagnose.posterior import GROUP_SHARE, Group
from sim2real.diagnose.search import LOG_PRIOR
from sim2real.servo.parameters import BASE

Array = NDArray[np.float64]

BORROWED = 2.0
"""References that what all effects gain together counts for."""
OTHER_MOTION = -4.0
"""Further log odds against a change where the case moves unlike its references, for what a servo
lacks then looks different, too: such that of recordings with nothing changed, made for it
(``datasets/concealed/real.py``, seed 77101), none is named."""
RETUNED = -2.0
"""Log odds that a parameter of the plain servo was set anew rather than that an effect came."""
FARTHEST = 4.0
"""Prior standard deviation of a change, in multiples of the start that it is extrapolated from."""
LAW_ERROR = 0.05
"""How far a straight line to a change may be from what it does, relative to the change."""
STRANGE = 0.95
"""Probability that a change has no name, where the best leaves most of it."""
_ROUNDS = 4


@dataclass(frozen=True)
class Contrast:
    """What a change of each effect would explain of a joint's case.

    Attributes:
        effects: The effects, and parameters of the plain servo, of which there are N.
        column: Direction of the pool that shows each best, shape (N,).
        size: Change in multiples of that direction, shape (N,).
        gain: Gain in log-likelihood when it is freed in the case alone, shape (N,).
        before: The same for each reference, shape (N, references).
        spread2: Twice the gain of each in an unchanged recording, at least that of noise, (N,).
        left: Energy of the case's innovations that it leaves, in variances of the loudest
            reference's, shape (N,).
        energy: The same with no change.
        count: Samples of the case.
        replicated: Whether the case repeats what its references do.
        theta: Parameters of the case with each change, shape (N, P), once they are fitted.
    """

    effects: tuple[str, ...]
    column: NDArray[np.intp]
    size: Array
    gain: Array
    before: Array
    spread2: Array
    left: Array
    energy: float
    count: float
    replicated: bool
    theta: Array | None = None

    @property
    def known(self) -> float:
        """Recordings that are known to be unchanged, borrowed ones included."""
        return BORROWED + float(self.before.shape[1])

    @property
    def common(self) -> float:
        """Twice the gain of any effect in an unchanged recording, at least that of noise."""
        return max(float(np.mean(2 * self.before)), 1.0)

    @property
    def evidence(self) -> Array:
        """Log odds of each change against none, without the prior, shape (N,)."""
        return _evidence(2 * self.gain / self.spread2, self.size, self.known)

    @property
    def misfit(self) -> Array:
        """What each leaves beyond what the best leaves, shape (N,).

        In nats, tempered by what references leave and by the error of the change's law.
        """
        best = float(self.left.min())
        whole = 0.5 * self.count * (self.energy - best) / self.spread2
        more = 0.5 * self.count * (self.left - best) / self.spread2
        return np.asarray(more / (1 + LAW_ERROR**2 * np.maximum(whole, 0.0)))

    @property
    def explained(self) -> Array:
        """Share that each takes of what the case has beyond its references, shape (N,)."""
        beyond = self.energy - 1
        if beyond <= 0:
            return np.full(len(self.effects), np.inf)
        return (self.energy - self.left) / beyond


@dataclass(frozen=True)
class Change:
    """What has changed on a joint.

    Attributes:
        group: The likeliest effect and those that it can't be told from. Nothing is resampled: its
            stability repeats its probability.
        probability: Of each effect, and of each parameter of the plain servo.
        strange: Probability that the change is none of them.
        theta: Parameters of the case with the likeliest effect, shape (P,), where it was fitted.
    """

    group: Group
    probability: Mapping[str, float]
    strange: float
    theta: Array | None = None


def change(found: Contrast) -> Change:
    """Probabilities of what has changed: each effect alone, or nothing."""
    best = int(np.argmax(found.evidence - found.misfit))
    odds = LOG_PRIOR + (0.0 if found.replicated else OTHER_MOTION)
    changed = float(expit(found.evidence[best] + odds))
    lonely = found.explained[best] < EXPLAINED
    strange = STRANGE if lonely else 0.0
    weight = np.exp(np.minimum(found.evidence - found.evidence[best], 0.0) - found.misfit)
    weight *= [np.exp(RETUNED) if n in BASE else 1.0 for n in found.effects]
    share = changed * (1 - strange) * weight / weight.sum()
    probability = {n: float(p) for n, p in zip(found.effects, share, strict=True)}
    order = sorted((n for n in found.effects if n not in BASE), key=lambda n: -probability[n])
    members = tuple(n for n in order if probability[n] >= GROUP_SHARE * probability[order[0]])
    sure = min(sum(probability[n] for n in members), MOST_CERTAIN)
    theta = None if found.theta is None else found.theta[found.effects.index(members[0])]
    return Change(Group(members, sure, sure), probability, strange * changed, theta)


def contrast(pool: Pool) -> Contrast:
    """Weigh a change of each effect against none, to first order."""
    R = pool.gram.shape[0]
    names = tuple(n for n in dict.fromkeys(pool.directions) if n != RIPPLE)
    place = [np.flatnonzero([d == n for d in pool.directions]) for n in names]
    alone = [gains(pool, [r])[0] for r in range(pool.references)]
    gain, size, left = gains(pool, range(pool.references, R))
    before = np.array([[one[mine].max() for one in alone] for mine in place])
    column = np.array([mine[np.argmax(gain[mine])] for mine in place])
    loudest = float((pool.gram[:, 0, 0] / pool.count)[: pool.references].max())
    own, count = pool.gram[pool.references :, 0, 0], float(pool.count[pool.references :].sum())
    unit = loudest * count
    known = BORROWED + pool.references
    common = BORROWED * float(np.mean(2 * before))
    spread2 = np.maximum((common + 2 * before.sum(axis=1)) / known, 1.0)
    whole = Contrast(
        names,
        column,
        size[column],
        gain[column],
        before,
        spread2,
        left[column] / unit,
        float(own.sum()) / unit,
        count,
        pool.replicated,
    )
    # Of several starts that which needs the least extrapolation to gain as much.
    score2 = [2 * gain[m] / s for m, s in zip(place, spread2, strict=True)]
    odds = [_evidence(t2, size[m], known) for t2, m in zip(score2, place, strict=True)]
    best = np.array([m[np.argmax(o)] for m, o in zip(place, odds, strict=True)])
    return replace(whole, column=best, size=size[best], gain=gain[best], left=left[best] / unit)


def _evidence(score2: Array, size: Array, known: float) -> Array:
    """Log odds of a change of unknown size, its score following Student's law where there is none.

    The integral over the size is Laplace's; a start that has to be extrapolated far is discounted.
    """
    far = np.maximum(np.abs(size) / FARTHEST, 1.0) ** 2
    nothing, rest = np.log1p(score2 / known), np.log1p(score2 * (1 - 1 / far) / known)
    return np.asarray(0.5 * (known + 1) * (nothing - rest) - 0.5 * np.log1p(score2))


def gains(pool: Pool, own: Sequence[int]) -> tuple[Array, Array, Array]:
    """Free each direction in some recordings only, the servo's parameters shared by all.

    Each recording has its own variance, at its best; all is linear in the parameters, so that a
    few rounds of weighted least squares end at the largest likelihood.

    Args:
        pool: The recordings.
        own: Those in which it is free.

    Returns:
        Gain in log-likelihood, change in multiples of the start, and sum of squared innovations
        that is left in these recordings, rad2, each of shape (K,).
    """
    F, K = pool.shared, pool.gram.shape[1] - 1
    mine = np.zeros(len(pool.gram))
    mine[list(own)] = 1.0
    error2 = pool.gram[:, 0, 0]
    slope = np.zeros((len(pool.gram), K, F + 1))
    slope[:, :, :F] = pool.gram[:, None, 1 : 1 + F, 0]
    slope[:, :, F] = pool.gram[:, 0, 1:] * mine[:, None]
    normal = np.zeros((len(pool.gram), K, F + 1, F + 1))
    normal[:, :, :F, :F] = pool.gram[:, None, 1 : 1 + F, 1 : 1 + F]
    cross = pool.gram[:, 1 : 1 + F, 1:] * mine[:, None, None]
    normal[:, :, :F, F] = normal[:, :, F, :F] = cross.transpose(0, 2, 1)
    normal[:, :, F, F] = np.diagonal(pool.gram, axis1=1, axis2=2)[:, 1:] * mine[:, None]
    plain, _ = _largest(error2, slope[:, :1, :F], normal[:, :1, :F, :F], pool.count)
    after, x = _largest(error2, slope, normal, pool.count)
    gain = 0.5 * pool.count @ np.log(plain / after)
    backwards = (x[:, F] < 0) & ~pool.signed
    gain = np.where(backwards, 0.0, np.maximum(gain, 0.0))
    return gain, x[:, F], mine @ after


def _largest(error2: Array, slope: Array, normal: Array, count: Array) -> tuple[Array, Array]:
    """Squared innovations (R, K) and parameters (K, F) where the likelihood is largest."""
    floor = 1e-9 * error2[:, None]
    now = np.repeat(error2[:, None], slope.shape[1], axis=1)
    x = np.zeros(slope.shape[1:])
    size = np.sqrt(np.einsum("rkff->kf", normal))
    size[size == 0] = 1.0
    for _ in range(_ROUNDS):
        weight = count[:, None] / now
        matrix = np.einsum("rk,rkfg->kfg", weight, normal) / (size[:, :, None] * size[:, None])
        right = -np.einsum("rk,rkf->kf", weight, slope) / size
        inverse = np.linalg.pinv(matrix, rcond=1e-9, hermitian=True)
        x = np.einsum("kfg,kg->kf", inverse, right) / size
        change = 2 * np.einsum("rkf,kf->rk", slope, x)
        change += np.einsum("kf,rkfg,kg->rk", x, normal, x)
        now = np.maximum(error2[:, None] + change, floor)
    return now, x
