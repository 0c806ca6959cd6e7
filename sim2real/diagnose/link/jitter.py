"""Latency jitter in what a fit leaves: its halfwidth and its log-likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.angle_noise import (
    RATIOS,
    Noise,
    NoisyJoint,
    WhitenedRegression,
    normals,
    regress,
)
from sim2real.diagnose.link.lost_packets import ROUNDS, Uneven
from sim2real.servo.linearised import EARLIEST_S, spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_HALFWIDTHS_S = np.geomspace(2.5e-4, 0.1, 7)
"""Halfwidths from which the search for jitter starts."""


@dataclass(frozen=True)
class _Delayed:
    """One joint, ready for the likelihood of any delays: normal equations in motion and at rest.

    ``joint`` is linear in the delays about some, ``plain`` as it was recorded.
    """

    plain: NoisyJoint
    joint: NoisyJoint
    noise: Noise
    moving: WhitenedRegression
    rest: WhitenedRegression

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

    def renewed(self, found: _Delays, *, pairs_drawn: int = 2, overstep: float = 1.5) -> _Delayed:
        """About the posterior mean of the delays, the noise refitted to what draws of them leave.

        Expectation maximisation: Dempster, Laird, Rubin, Journal of the Royal Statistical Society B
        39 (1977) 1-38. Its steps are short; it climbs as long as ``overstep`` is below 2.
        """
        rng = np.random.default_rng(0)  # stands in for an integral; the same draws every time
        signs = rng.choice([-1.0, 1.0], size=(found.mean.size, pairs_drawn))
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
        noise = replace(found.noise, model=old + overstep * (model - old))
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


def latency_jitter(joints: Sequence[NoisyJoint], worth: float = 0.0) -> Uneven:
    """Estimate the jitter of one link from all joints on it.

    Delays are taken for independent and Gaussian, so that the innovations are jointly Gaussian.
    Responses are linear in them, first about 0, then about their posterior mean (Laplace's method).

    Args:
        joints: The joints. Delays of one set-point at several joints count as independent.
        worth: Gain a sample below which a closer look is not worth it.
    """
    every = [_Delayed.of(joint, joint, joint.noise) for joint in joints]
    trials = [_total(every, float(h) / np.sqrt(3)) for h in _HALFWIDTHS_S]
    sd_s = float(_HALFWIDTHS_S[int(np.argmax(trials))] / np.sqrt(3))
    least = sum(joint.alone(joint.noise) for joint in joints)
    best, before = Uneven("latency_jitter"), 0.0
    samples = sum(joint.counts[0] for joint in joints)
    for _ in range(ROUNDS):
        sd_s, error = _likeliest(every, sd_s)
        plain = [one.noise for one in every]
        every = [one.with_ratio(sd_s) for one in every]
        for noises in (plain, [one.noise for one in every]):
            least = max(least, sum(j.alone(x) for j, x in zip(joints, noises, strict=True)))
        found = [one.at(sd_s) for one in every]
        gain = sum(one.loglikelihood for one in found) - least
        if gain > max(best.gain, DECISION.link.min_gain):
            period = [s.response.period_s for joint in joints for s in joint.segments]
            widest = halfwidth(sd_s, float(np.median(period)))
            best = Uneven("latency_jitter", gain, widest, error * widest / sd_s)
        if gain < max(DECISION.link.min_gain, worth * samples) or abs(gain - before) < max(
            DECISION.link.min_gain, 0.01 * gain
        ):
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


def _climb(
    f: Callable[[float], float], x: float, step: float, *, steps: int = 8
) -> tuple[float, float]:
    """Place of a maximum near ``x`` by a parabola through three points, and its curvature."""
    below, here, above = f(x - step), f(x), f(x + step)
    for _ in range(steps):
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
