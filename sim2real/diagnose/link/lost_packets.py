"""Packet loss in what a fit leaves: which set-points were lost, and the log-likelihood of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.special import expit, xlogy

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.angle_noise import (
    Noise,
    NoisyJoint,
    WhitenedRegression,
    normals,
    regress,
)
from sim2real.inference.correlated_noise import whitened
from sim2real.inference.normal import SD_PER_MEDIAN
from sim2real.servo.linearised import spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDS = 5
"""Gain below which another round can find nothing, and growth of the gain that ends them."""
_RUN, _TAIL = 3, 3
"""Set-points in a row whose fates are weighed together, and lost ones after them."""
_PATTERNS = np.array([[b >> i & 1 for i in range(_RUN)] for b in range(2**_RUN)], dtype=bool)
"""What may happen to them, shape (8, 3)."""


@dataclass(frozen=True)
class Uneven:
    """What an uneven link explains of what a robot's fits leave.

    Attributes:
        effect: ``latency_jitter`` or ``packet_loss``.
        gain: Log-likelihood that it gains over the noise alone, choices paid for.
        value: The effect's parameter: halfwidth in s, or probability.
        sd: Its standard deviation; infinite where nothing is found.
        shares: Gain at each joint by itself.
    """

    effect: str
    gain: float = 0.0
    value: float = 0.0
    sd: float = np.inf
    shares: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Lossy:
    """One joint, ready for the likelihood of any set of lost set-points."""

    joint: NoisyJoint
    noise: Noise
    normal: WhitenedRegression
    change: Array

    @classmethod
    def of(cls, joint: NoisyJoint, noise: Noise) -> _Lossy:
        moving, rest = normals(joint, noise, [s.response.missing for s in joint.segments])
        change = np.concatenate([s.response.change for s in joint.segments])
        return cls(joint, noise, moving.plus(rest, noise.ratio**-2), change)

    def below(self, lost: Mask) -> Array:
        """How far the set-points in force are below those sent, in rad, shape (K,)."""
        out = np.zeros(lost.size)
        for k in np.flatnonzero(lost):
            out[k] = out[k - 1] + self.change[k]
        return out

    def fitted(self, below: Array, spare: float = 0.0) -> tuple[Noise, float]:
        """The noise with variance and ``refit`` at their best, and the log-likelihood.

        Args:
            below: See above.
            spare: To be added to the weighted sum of squared innovations, in rad2.
        """
        square, along = self.normal.square.copy(), self.normal.cross.T @ below
        square[0, 0] += below @ self.normal.times(below) - 2 * along[0] + spare
        square[0, 1:] -= along[1:]
        square[1:, 0] -= along[1:]
        refit, error2 = regress(square)
        noise = replace(self.noise, variance=self.joint.variance(error2), refit=refit)
        return noise, self.joint.loglikelihood(error2, noise.ratio)

    def gains(self, lost: Mask, at: NDArray[np.intp]) -> Array:
        """Gains in nats if, from set-points ``at`` (N,) on, each pattern happened, shape (8, N)."""
        reach = _RUN + _TAIL
        below = self.below(lost)
        left = self.normal.cross @ np.concatenate([[1.0], -self.noise.refit])
        left -= self.normal.times(below)
        ahead = at + np.arange(reach)[:, None]
        beyond = ahead >= lost.size
        ahead[beyond] = 0
        gone, under, change, slopes = (x[ahead] for x in (lost, below, self.change, left))
        gone[beyond] = False
        under[beyond] = 0.0
        gram = self.normal.gram[:reach, ahead]
        before = np.concatenate([[0.0], below])[at]
        step, now = [], np.broadcast_to(before, (len(_PATTERNS), at.size))
        for i in range(reach):
            fate = _PATTERNS[:, i : i + 1] if i < _RUN else gone[i]
            now = np.where(fate, change[i] + now, 0.0)
            step.append(now - under[i])
        gain = np.zeros((len(_PATTERNS), at.size))
        for i in range(reach):
            slope = slopes[i] - 0.5 * gram[0, i] * step[i]
            for j in range(i + 1, min(reach, i + len(gram))):
                slope -= gram[j - i, i] * step[j]
            gain += slope * step[i]
        return gain / self.noise.variance

    def moments(self, share: Array) -> tuple[Array, float]:
        """Mean of ``below`` (K,), and the weighted square of its scatter's response in rad2.

        Args:
            share: Probability that each set-point is lost, independently, shape (K,).
        """
        mean, square, m, s = [], [], 0.0, 0.0
        for q, change in zip(share.tolist(), self.change.tolist(), strict=True):
            s = q * (change * change + 2 * change * m + s)
            m = q * (change + m)
            mean.append(m)
            square.append(s)
        covariance = np.array(square) - np.array(mean) ** 2
        scatter = float(self.normal.gram[0] @ covariance)
        for d in range(1, min(_RUN + _TAIL, len(self.normal.gram), share.size)):
            covariance = covariance[:-1] * share[d:]
            scatter += 2 * float(self.normal.gram[d, : share.size - d] @ covariance)
        return np.array(mean), scatter

    def renewed(self, share: Array) -> _Lossy:
        """The same with the noise refitted to what the mean of the losses leaves."""
        mean, scatter = self.moments(share)
        noise, _ = self.fitted(mean, scatter)
        left = [
            s.left(noise.refit) - spread(s.response.missing * part[:, None], s.response.first)
            for s, part in zip(self.joint.segments, self.joint.by_recording(mean), strict=True)
        ]
        noise = self.joint.remodelled(noise, [[x] for x in left])
        ratio = self.joint.ratio([whitened(x, noise.model) for x in left])
        return _Lossy.of(self.joint, replace(noise, ratio=ratio))


def packet_loss(joints: Sequence[NoisyJoint], *, first_probability: float = 0.02) -> Uneven:
    """Find the set-points that one link lost, for all its joints at once.

    The likeliest set of losses, each charged with log((1 - p) / p), is searched best first. Around
    it every set-point is given its own probability of being lost, which makes a lower bound of the
    marginal likelihood (Jordan, Ghahramani, Jaakkola, Saul, Machine Learning 37 (1999) 183-233):
    expected log-likelihood, less the divergence from independent losses of probability p. So the
    choice of the losses is paid for.

    Args:
        joints: The joints. Where they have different recordings, each has losses of its own.
        first_probability: Probability of a loss with which the search starts.
    """
    sizes = {tuple(s.residual.size for s in joint.segments) for joint in joints}
    if len(sizes) > 1:
        alone = [packet_loss([joint]) for joint in joints]
        best = max(alone, key=lambda one: one.gain)
        return replace(best, gain=sum(one.gain for one in alone))
    first = np.zeros(sum(*sizes), dtype=bool)
    first[np.cumsum([0, *next(iter(sizes))])[:-1]] = True  # in force from the start
    every = [_Lossy.of(joint, _typical(joint)) for joint in joints]
    lost, p = np.zeros_like(first), first_probability
    least = sum(joint.alone(joint.noise) for joint in joints)
    best, before = Uneven("packet_loss"), 0.0
    for _ in range(ROUNDS):
        every, lost, p = _searched(every, lost, first, p)
        if not lost.any():
            break
        odds = float(np.log(p / (1 - p)))
        unsure = np.where(first, 0.0, expit(_evidence(every, lost, first) + odds))
        value, share = max(
            ((_bound(every, x, first, p), x) for x in (unsure, lost.astype(np.float64))),
            key=lambda pair: pair[0],
        )
        noises = [one.noise for one in every]
        least = max(least, sum(j.alone(x) for j, x in zip(joints, noises, strict=True)))
        gain = value - least
        if gain > best.gain:
            q = share[~first]
            information = float(np.sum((q / p - (1 - q) / (1 - p)) ** 2))
            best = Uneven("packet_loss", gain, p, information**-0.5 if information else np.inf)
        if before > 0 and gain < max(before + DECISION.link.min_gain, 1.01 * before):
            break
        before = gain
        every = [one.renewed(share) for one in every]
    return best


def _typical(joint: NoisyJoint) -> Noise:
    """The noise with the variance of most samples, not of those that losses disturb."""
    noise = joint.noise
    sizes = [
        np.abs(whitened(s.left(noise.refit), noise.model) * s.weight(noise.ratio))[s.counts]
        for s in joint.segments
    ]
    sd = SD_PER_MEDIAN * float(np.median(np.concatenate(sizes)))
    return replace(noise, variance=joint.variance(joint.counts[0] * sd**2))


def _ahead(mask: Mask, i: int, *, beyond: bool = False) -> Mask:
    """The mask ``i`` set-points further on, shape (K,)."""
    return np.concatenate([mask[i:], np.full(min(i, mask.size), beyond)])


def _gains(
    every: Sequence[_Lossy], lost: Mask, first: Mask, log_odds: float, at: NDArray[np.intp]
) -> Array:
    """Gain of each pattern from each of the set-points ``at`` on, paid for, shape (8, N)."""
    now = np.stack([_ahead(lost, i)[at] for i in range(_RUN)]).sum(axis=0)
    gain = log_odds * (_PATTERNS.sum(axis=1)[:, None] - now)
    for joint in every:
        gain = gain + joint.gains(lost, at)
    fixed = np.stack([_ahead(first, i, beyond=True)[at] for i in range(_RUN)])
    return np.where(_PATTERNS.astype(np.intp) @ fixed, -np.inf, gain)


def _evidence(every: Sequence[_Lossy], lost: Mask, first: Mask) -> Array:
    """Log-likelihood ratio of loss and arrival of each set-point, the others given, (K,)."""
    gain = _gains(every, lost, first, 0.0, np.arange(lost.size))
    after = sum(2**i * _ahead(lost, i) for i in range(1, _RUN))
    other = gain[after + ~lost, np.arange(lost.size)]
    return np.asarray(np.where(lost, -other, other))


def _searched(
    every: list[_Lossy],
    lost: Mask,
    first: Mask,
    p: float,
    *,
    limits: tuple[float, float] = (1e-4, 0.5),
    sweeps: int = 60,
    least_gain: float = 1e-3,
) -> tuple[list[_Lossy], Mask, float]:
    """The likeliest losses that changes of three in a row reach, with the noise and p."""
    # So far apart that one change does not alter what another is worth.
    reach = 2 * (max(len(one.normal.gram) for one in every) + _RUN + _TAIL) + 1
    for _ in range(4):
        before, lost = lost, lost.copy()
        odds = float(np.log(p / (1 - p)))
        gain = _gains(every, lost, first, odds, np.arange(lost.size))
        for _ in range(sweeps):
            best = gain.max(axis=0)
            chosen = (best > least_gain) & (best >= maximum_filter1d(best, reach))
            if not chosen.any():
                break
            for k in np.flatnonzero(chosen):
                lost[k : k + _RUN] = _PATTERNS[gain[:, k].argmax(), : lost.size - k]
            near = np.flatnonzero(maximum_filter1d(chosen, reach))
            gain[:, near] = _gains(every, lost, first, odds, near)
        every = [replace(one, noise=one.fitted(one.below(lost))[0]) for one in every]
        evidence = _evidence(every, lost, first)[~first]
        for _ in range(20):
            p = float(np.clip(expit(evidence + np.log(p / (1 - p))).mean(), *limits))
        if (before == lost).all():
            break
    return every, lost, p


def _bound(every: Sequence[_Lossy], share: Array, first: Mask, p: float) -> float:
    """Lower bound of the log-likelihood for independent losses of probability ``p``."""
    q = share[~first]
    paid = float(np.sum(xlogy(q, q / p) + xlogy(1 - q, (1 - q) / (1 - p))))
    return sum(one.fitted(*one.moments(share))[1] for one in every) - paid
