"""The link to a robot: do its set-points arrive unevenly, or not at all?

A delay of one set-point or its loss is a random event of its own, so that no refit reproduces it.
But what it does to the angle is known, a short response in proportion to the change of the
set-point, and the sum of all such responses is found in the residual by its likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.ndimage import maximum_filter1d
from scipy.special import expit, xlogy

from sim2real.diagnose.link_response import (
    EARLIEST_S,
    RATIOS,
    Noise,
    NoisyJoint,
    Normal,
    Residual,
    normals,
    regress,
    spread,
    with_noise,
)
from sim2real.diagnose.processes import shared
from sim2real.inference.noise import whitened

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WORTH = 0.3
"""Gain below which another round can find nothing, and growth of the gain that ends them."""
_ROUNDS = 5
_HALFWIDTHS_S = np.geomspace(2.5e-4, 0.1, 7)
"""Halfwidths from which the search for jitter starts."""
_STEPS, _DRAWS, _OVERSTEP = 8, 4, 1.5
"""Steps of expectation maximisation are short; it climbs as long as the last is below 2."""
_START, _LIMITS = 0.02, (1e-4, 0.5)
"""Probability of a loss with which the search starts; its bounds."""
_SWEEPS, _LEAST_GAIN, _MEDIAN = 60, 1e-3, 1.4826
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
class LinkData:
    """Residuals of one robot's fits: for each joint its recordings, and what the noise may be."""

    joints: tuple[tuple[Residual, ...], ...]
    lags: int
    least_gain: float
    noticed: float = 0.0


def links(robots: Sequence[LinkData]) -> list[Uneven]:
    """The likelier of the two effects on every robot's link; ``gain`` 0 below what is noticed."""
    return shared(link, robots)


def link(robot: LinkData) -> Uneven:
    """The likelier of the two effects on one robot's link."""
    joints = [with_noise(joint, robot.lags, robot.least_gain) for joint in robot.joints]
    found = max((effect(joints) for effect in (latency_jitter, packet_loss)), key=lambda x: x.gain)
    if found.gain < robot.noticed:
        return Uneven(found.effect, shares=tuple(0.0 for _ in joints))
    alone = latency_jitter if found.effect == "latency_jitter" else packet_loss
    return replace(found, shares=tuple(alone([joint]).gain for joint in joints))


@dataclass(frozen=True)
class _Delayed:
    """One joint, ready for the likelihood of any delays: normal equations in motion and at rest.

    ``joint`` is linear in the delays about some, ``plain`` as it was recorded.
    """

    plain: NoisyJoint
    joint: NoisyJoint
    noise: Noise
    moving: Normal
    rest: Normal

    @classmethod
    def of(cls, plain: NoisyJoint, joint: NoisyJoint, noise: Noise) -> _Delayed:
        tables = [s.response.late for s in joint.segments]
        return cls(plain, joint, noise, *normals(joint, noise, tables))

    def at(self, sd_s: float) -> _Delays:
        """The likelihood of delays of this standard deviation.

        They are integrated out by the Woodbury identity and the determinant lemma (Golub, Van Loan,
        Matrix Computations, 4th ed., 2013, 2.1.4); their precision is banded.
        """
        noise = self.noise
        normal = self.moving.plus(self.rest, noise.ratio**-2)
        odds = sd_s**2 / noise.variance
        precision = normal.gram * odds
        precision[0] += 1.0
        factor = cholesky_banded(precision, lower=True, overwrite_ab=True, check_finite=False)
        taken = cho_solve_banded((factor, True), normal.cross, check_finite=False) * odds
        refit, error2 = regress(normal.square - normal.cross.T @ taken)
        value = self.joint.loglikelihood(error2, noise.ratio) - float(np.log(factor[0]).sum())
        after = replace(noise, variance=self.joint.variance(error2), refit=refit)
        mean = taken @ np.concatenate([[1.0], -refit])
        return _Delays(value, after, mean, factor, float(np.sqrt(odds * after.variance)))

    def with_ratio(self, sd_s: float) -> _Delayed:
        """The same with the ratio of its noise at its likeliest."""
        every, rest = self.joint.counts
        if rest in (0, every):
            return self

        def tried(x: float) -> _Delayed:
            ratio = float(np.clip(np.exp(x), *RATIOS))
            return replace(self, noise=replace(self.noise, ratio=ratio))

        start = float(np.log(self.noise.ratio))
        return tried(_climb(lambda x: tried(x).at(sd_s).loglikelihood, start, 0.2)[0])

    def renewed(self, found: _Delays) -> _Delayed:
        """About the posterior mean of the delays, the noise refitted to what draws of them leave.

        Expectation maximisation: Dempster, Laird, Rubin, Journal of the Royal Statistical Society B
        39 (1977) 1-38.
        """
        rng = np.random.default_rng(0)  # stands in for an integral; the same draws every time
        signs = rng.choice([-1.0, 1.0], size=(found.mean.size, _DRAWS))
        around = dtbtrs(found.factor, signs, uplo="L", trans="T")[0] * found.sd_s
        draws = found.mean[:, None] + np.concatenate([around, -around], axis=1)
        by_recording = [self.joint.by_recording(draw) for draw in draws.T]
        series = [
            [
                s.left(found.noise.refit)
                - spread(s.response.late * one[r][:, None], s.response.first)
                for one in by_recording
            ]
            for r, s in enumerate(self.joint.segments)
        ]
        model = self.joint.remodelled(found.noise, series).model
        old = found.noise.model
        noise = replace(found.noise, model=old + _OVERSTEP * (model - old))
        most, segments = found.sd_s * np.sqrt(3), []
        means = self.plain.by_recording(found.mean)
        for s, mean in zip(self.plain.segments, means, strict=True):
            delay = np.clip(mean, -min(most, EARLIEST_S), most)
            angle, late = s.response.late_by(delay)
            linear = spread(late * delay[:, None], s.response.first)
            bent = replace(s.response, late=late)
            segments.append(replace(s, residual=s.residual - angle + linear, response=bent))
        about = replace(self.plain, segments=tuple(segments))
        return _Delayed.of(self.plain, about, noise)


@dataclass(frozen=True)
class _Delays:
    """Likelihood of one joint for one size of delays, with what it takes to draw from them.

    Attributes:
        loglikelihood: Its logarithm, the noise's variance and ``refit`` at their best.
        noise: The noise.
        mean: Posterior mean of the delays in s, shape (K,).
        factor: Lower Cholesky factor of their precision times ``sd_s**2``, shape (W, K).
        sd_s: Prior standard deviation of the delays.
    """

    loglikelihood: float
    noise: Noise
    mean: Array
    factor: Array
    sd_s: float


def latency_jitter(joints: Sequence[NoisyJoint]) -> Uneven:
    """Estimate the jitter of one link from all joints on it.

    Delays are taken for independent and Gaussian, so that the innovations are jointly Gaussian.
    Responses are linear in them, first about 0, then about their posterior mean (Laplace's method).

    Args:
        joints: The joints. Delays of one set-point at several joints count as independent.
    """
    every = [_Delayed.of(joint, joint, joint.noise) for joint in joints]
    trials = [_total(every, float(h) / np.sqrt(3)) for h in _HALFWIDTHS_S]
    sd_s = float(_HALFWIDTHS_S[int(np.argmax(trials))] / np.sqrt(3))
    least = sum(joint.alone(joint.noise) for joint in joints)
    best, before = Uneven("latency_jitter"), 0.0
    for _ in range(_ROUNDS):
        sd_s, error = _likeliest(every, sd_s)
        plain = [one.noise for one in every]
        every = [one.with_ratio(sd_s) for one in every]
        for noises in (plain, [one.noise for one in every]):
            least = max(least, sum(j.alone(x) for j, x in zip(joints, noises, strict=True)))
        found = [one.at(sd_s) for one in every]
        gain = sum(one.loglikelihood for one in found) - least
        if gain > max(best.gain, _WORTH):
            period = [s.response.period_s for joint in joints for s in joint.segments]
            widest = halfwidth(sd_s, float(np.median(period)))
            best = Uneven("latency_jitter", gain, widest, error * widest / sd_s)
        if gain < _WORTH or abs(gain - before) < max(_WORTH, 0.01 * gain):
            break
        before = gain
        sd_s = float(np.exp(np.mean([np.log(one.sd_s) for one in found])))
        every = [one.renewed(delays) for one, delays in zip(every, found, strict=True)]
    return best


def halfwidth(sd_s: float, period_s: float) -> float:
    """Halfwidth of uniform delays in s, from their standard deviation once none overtakes.

    Args:
        sd_s: Standard deviation in s that independent delays would need to do the same.
        period_s: Time between set-points.
    """
    widths, sds = _ordered_delays()
    return sd_s * float(np.interp(sd_s / period_s, sds, widths / sds))


@lru_cache
def _ordered_delays() -> tuple[Array, Array]:
    """Halfwidths of delays, and their standard deviations once none overtakes, in periods.

    A set-point is as late as the latest of those before it. Neighbours add up in the angle, so the
    standard deviation is that of the mean of many, as if each were independent; by simulation.
    """
    rng, sent = np.random.default_rng(0), np.arange(200_000.0)
    draws = rng.uniform(-1, 1, size=sent.size)
    widths = np.concatenate([[0.01], np.geomspace(0.3, 20, 16)])
    late = [np.maximum.accumulate(sent + width * draws) - sent for width in widths]
    return widths, np.array([x.reshape(-1, 200).mean(axis=1).std() * np.sqrt(200) for x in late])


def _total(every: Sequence[_Delayed], sd_s: float) -> float:
    return sum(one.at(sd_s).loglikelihood for one in every)


def _likeliest(every: Sequence[_Delayed], start: float) -> tuple[float, float]:
    """Standard deviation of the delays in s at its likeliest, and that of its estimate."""
    x, bend = _climb(lambda x: _total(every, float(np.exp(x))), float(np.log(start)), 0.4)
    return float(np.exp(x)), float(np.exp(x) / np.sqrt(bend)) if bend > 0 else np.inf


def _climb(f: Callable[[float], float], x: float, step: float) -> tuple[float, float]:
    """Place of a maximum near ``x`` by a parabola through three points, and its curvature."""
    below, here, above = f(x - step), f(x), f(x + step)
    for _ in range(_STEPS):
        if above > max(here, below):
            x, below, here, above = x + step, here, above, f(x + 2 * step)
        elif below > here:
            x, below, here, above = x - step, f(x - 2 * step), below, here
        else:
            break
    bend = 2 * here - below - above
    if bend <= 0:
        return x, 0.0
    return x + float(np.clip((above - below) / (2 * bend), -1, 1)) * step, bend / step**2


@dataclass(frozen=True)
class _Lossy:
    """One joint, ready for the likelihood of any set of lost set-points."""

    joint: NoisyJoint
    noise: Noise
    normal: Normal
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


def packet_loss(joints: Sequence[NoisyJoint]) -> Uneven:
    """Find the set-points that one link lost, for all its joints at once.

    The likeliest set of losses, each charged with log((1 - p) / p), is searched best first. Around
    it every set-point is given its own probability of being lost, which makes a lower bound of the
    marginal likelihood (Jordan, Ghahramani, Jaakkola, Saul, Machine Learning 37 (1999) 183-233):
    expected log-likelihood, less the divergence from independent losses of probability p. So the
    choice of the losses is paid for.

    Args:
        joints: The joints. Where they have different recordings, each has losses of its own.
    """
    sizes = {tuple(s.residual.size for s in joint.segments) for joint in joints}
    if len(sizes) > 1:
        alone = [packet_loss([joint]) for joint in joints]
        best = max(alone, key=lambda one: one.gain)
        return replace(best, gain=sum(one.gain for one in alone))
    first = np.zeros(sum(*sizes), dtype=bool)
    first[np.cumsum([0, *next(iter(sizes))])[:-1]] = True  # in force from the start
    every = [_Lossy.of(joint, _typical(joint)) for joint in joints]
    lost, p = np.zeros_like(first), _START
    least = sum(joint.alone(joint.noise) for joint in joints)
    best, before = Uneven("packet_loss"), 0.0
    for _ in range(_ROUNDS):
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
        if before > 0 and gain < max(before + _WORTH, 1.01 * before):
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
    sd = _MEDIAN * float(np.median(np.concatenate(sizes)))
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
    every: list[_Lossy], lost: Mask, first: Mask, p: float
) -> tuple[list[_Lossy], Mask, float]:
    """The likeliest losses that changes of three in a row reach, with the noise and p."""
    # So far apart that one change does not alter what another is worth.
    reach = 2 * (max(len(one.normal.gram) for one in every) + _RUN + _TAIL) + 1
    for _ in range(4):
        before, lost = lost, lost.copy()
        odds = float(np.log(p / (1 - p)))
        gain = _gains(every, lost, first, odds, np.arange(lost.size))
        for _ in range(_SWEEPS):
            best = gain.max(axis=0)
            chosen = (best > _LEAST_GAIN) & (best >= maximum_filter1d(best, reach))
            if not chosen.any():
                break
            for k in np.flatnonzero(chosen):
                lost[k : k + _RUN] = _PATTERNS[gain[:, k].argmax(), : lost.size - k]
            near = np.flatnonzero(maximum_filter1d(chosen, reach))
            gain[:, near] = _gains(every, lost, first, odds, near)
        every = [replace(one, noise=one.fitted(one.below(lost))[0]) for one in every]
        evidence = _evidence(every, lost, first)[~first]
        for _ in range(20):
            p = float(np.clip(expit(evidence + np.log(p / (1 - p))).mean(), *_LIMITS))
        if (before == lost).all():
            break
    return every, lost, p


def _bound(every: Sequence[_Lossy], share: Array, first: Mask, p: float) -> float:
    """Lower bound of the log-likelihood for independent losses of probability ``p``."""
    q = share[~first]
    paid = float(np.sum(xlogy(q, q / p) + xlogy(1 - q, (1 - q) / (1 - p))))
    return sum(one.fitted(*one.moments(share))[1] for one in every) - paid
