"""Latency jitter in what a plain fit leaves: its halfwidth and its log-likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from sim2real.diagnose.arrival_banded import Normal, normals
from sim2real.diagnose.arrival_noise import RATIOS, Heard, Noise, regress
from sim2real.diagnose.arrival_response import EARLIEST_S, spread

Array = NDArray[np.float64]

HALFWIDTHS_S = np.geomspace(2.5e-4, 0.1, 7)
"""Halfwidths from which the search starts."""
_ROUNDS = 5
_WORTH = 0.3
"""Gain below which another round can find nothing, and change of the gain that ends them."""
_STEPS = 8
_GRID = 48
_DRAWS = 4
_OVERSTEP = 1.5
"""Steps of expectation maximisation are short; it climbs as long as this is below 2."""


@dataclass(frozen=True)
class Jitter:
    """What an uneven arrival of set-points would explain.

    Attributes:
        gain: Gain in log-likelihood, in nats.
        halfwidth_s: Most that a set-point is early or late.
        sd_s: Standard deviation of the estimate; where nothing is found, the halfwidth that would
            show; infinite where none would.
        explained: For each joint and recording the part of the residual, simulated minus measured
            angle, in rad, that it explains (posterior mean), shape (T,).
    """

    gain: float
    halfwidth_s: float
    sd_s: float
    explained: tuple[tuple[Array, ...], ...]


@dataclass(frozen=True)
class _Sight:
    """One joint, ready for the likelihood of any delays.

    Attributes:
        heard: The joint.
        noise: Noise under which it is looked at.
        moving: Normal equations of the samples in motion.
        rest: And of those at rest.
    """

    heard: Heard
    noise: Noise
    moving: Normal
    rest: Normal


@dataclass(frozen=True)
class _Value:
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


def latency_jitter(joints: Sequence[Heard]) -> Jitter:
    """Estimate the jitter of one link from all joints on it.

    Delays are taken for independent and Gaussian, so that the innovations are jointly Gaussian. The
    delays are integrated out by the Woodbury identity and the determinant lemma (Golub, Van Loan,
    Matrix Computations, 4th ed., 2013, 2.1.4); their precision is banded. Responses are linear in
    them, first about 0, then about their posterior mean (Laplace's method). The noise is refitted
    by expectation maximisation (Dempster, Laird, Rubin, Journal of the Royal Statistical Society B
    39 (1977) 1-38), its expectations taken over draws of the delays.

    Args:
        joints: The joints. Delays of one set-point at several joints count as independent.
    """
    noises = [heard.noise for heard in joints]
    moved, about = list(joints), list(joints)
    sights = [_sight(*pair) for pair in zip(joints, noises, strict=True)]
    trials = np.array([_total(sights, h / np.sqrt(3)) for h in HALFWIDTHS_S])
    sd_s = HALFWIDTHS_S[int(trials.argmax())] / np.sqrt(3)
    least = sum(heard.alone(heard.noise) for heard in joints)
    best = Jitter(0.0, 0.0, _visible(trials - least), _explained(joints, joints, None))
    before = 0.0
    for _ in range(_ROUNDS):
        sd_s, error = _likeliest(sights, sd_s)
        sights = [_with_ratio(sight, sd_s) for sight in sights]
        for noise in (noises, [sight.noise for sight in sights]):
            least = max(least, sum(h.alone(x) for h, x in zip(joints, noise, strict=True)))
        values = [_value(sight, sd_s) for sight in sights]
        gain = sum(value.loglikelihood for value in values) - least
        if gain > max(best.gain, _WORTH):
            explained = _explained(moved, about, values)
            widest = halfwidth(sd_s, _period(joints))
            best = Jitter(gain, widest, error * widest / sd_s, explained)
        if gain < _WORTH or abs(gain - before) < max(_WORTH, 0.01 * gain):
            break
        before = gain
        sd_s = float(np.exp(np.mean([np.log(value.sd_s) for value in values])))
        noises = [_renewed(*pair) for pair in zip(sights, values, strict=True)]
        moved = [h.moved(value.noise.refit) for h, value in zip(moved, values, strict=True)]
        about = [_about(*pair) for pair in zip(moved, values, strict=True)]
        sights = [_sight(*pair) for pair in zip(about, noises, strict=True)]
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
    """Halfwidths of delays before and standard deviations after none overtakes, in periods.

    A set-point is as late as the latest of those before it, D_k = max over j of xi_(k-j) - j, so
    that P(D_k <= x) = H(x) is the product over j of F(x + j), F the uniform distribution. By
    Hoeffding's formula cov(D_k, D_(k+m)) is the double integral of P(D_k <= x, D_(k+m) <= y) -
    H(x) H(y), and P(D_k <= x, D_(k+m) <= y) = H(min(x, y + m)) H(y) / H(y + m). Neighbours add up
    in the angle, so the standard deviation is that of the sum of many, each taken for independent.
    """
    widths, sds = np.geomspace(0.5, 20, 14), []
    for width in widths:
        x = (np.arange(_GRID) + 0.5) / _GRID * 2 * width - width
        variance = 0.0
        for m in range(int(2 * width) + 1):
            early, late = _below(x, width), _below(x + m, width)
            both = _below(np.minimum(x[:, None], x + m), width)
            share = _below(x, width) / np.maximum(late, 1e-300)
            covariance = np.sum((both - early[:, None] * late) * share) * (2 * width / _GRID) ** 2
            variance += covariance if m == 0 else 2 * covariance
        sds.append(np.sqrt(variance))
    return np.concatenate([[0.01], widths]), np.concatenate([[0.01 / np.sqrt(3)], sds])


def _below(x: Array, width: float) -> Array:
    """H of ``_ordered_delays`` at ``x``, of any shape."""
    share = np.ones_like(x)
    for older in range(int(2 * width) + 1):
        share *= np.clip((x + older + width) / (2 * width), 0, 1)
    return share


def _period(joints: Sequence[Heard]) -> float:
    return float(np.median([s.response.period_s for heard in joints for s in heard.stretches]))


def _visible(gains: Array) -> float:
    """Halfwidth in s that would cost half a nat, from the gains at ``HALFWIDTHS_S``."""
    if gains[-1] > -0.5:
        return np.inf
    k = int(np.flatnonzero(gains > -0.5)[-1]) + 1 if (gains > -0.5).any() else 0
    return float(HALFWIDTHS_S[k])


def _explained(
    joints: Sequence[Heard], about: Sequence[Heard], values: Sequence[_Value] | None
) -> tuple[tuple[Array, ...], ...]:
    """The part of each residual that the posterior mean of the delays explains.

    Args:
        joints: The joints as they are.
        about: The same, linearised about some delays.
        values: What was found, or None where nothing was.
    """
    found = []
    for n, (plain, linear) in enumerate(zip(joints, about, strict=True)):
        pairs = list(zip(plain.stretches, linear.stretches, strict=True))
        if values is None:
            found.append(tuple(np.zeros(s.residual.size) for s, _ in pairs))
            continue
        means = plain.by_recording(values[n].mean)
        found.append(
            tuple(
                s.residual - x.residual + spread(x.response.late * mean[:, None], x.response.first)
                for (s, x), mean in zip(pairs, means, strict=True)
            )
        )
    return tuple(found)


def _sight(heard: Heard, noise: Noise) -> _Sight:
    tables = [s.response.late for s in heard.stretches]
    return _Sight(heard, noise, *normals(heard.stretches, tables, noise.autoregression))


def _value(sight: _Sight, sd_s: float) -> _Value:
    """Likelihood of delays of standard deviation ``sd_s`` under the noise of ``sight``."""
    noise = sight.noise
    normal = sight.moving.plus(sight.rest, noise.ratio**-2)
    odds = sd_s**2 / noise.variance
    precision = normal.gram * odds
    precision[0] += 1.0
    factor = cholesky_banded(precision, lower=True, overwrite_ab=True, check_finite=False)
    taken = cho_solve_banded((factor, True), normal.cross, check_finite=False) * odds
    refit, error2 = regress(normal.square - normal.cross.T @ taken)
    value = sight.heard.loglikelihood(error2, noise.ratio) - float(np.log(factor[0]).sum())
    after = replace(noise, variance=sight.heard.variance(error2), refit=refit)
    mean = taken @ np.concatenate([[1.0], -refit])
    return _Value(value, after, mean, factor, float(np.sqrt(odds * after.variance)))


def _total(sights: Sequence[_Sight], sd_s: float) -> float:
    return sum(_value(sight, sd_s).loglikelihood for sight in sights)


def _likeliest(sights: Sequence[_Sight], start: float) -> tuple[float, float]:
    """Standard deviation of the delays in s at its likeliest, and that of its estimate."""
    x, bend = _climb(lambda x: _total(sights, float(np.exp(x))), float(np.log(start)), 0.4)
    return float(np.exp(x)), float(np.exp(x) / np.sqrt(bend)) if bend > 0 else np.inf


def _with_ratio(sight: _Sight, sd_s: float) -> _Sight:
    """The same with the ratio of its noise at its likeliest."""
    every, rest = sight.heard.counts
    if rest in (0, every):
        return sight

    def at(x: float) -> _Sight:
        ratio = float(np.clip(np.exp(x), *RATIOS))
        return replace(sight, noise=replace(sight.noise, ratio=ratio))

    start = float(np.log(sight.noise.ratio))
    return at(_climb(lambda x: _value(at(x), sd_s).loglikelihood, start, 0.2)[0])


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


def _renewed(sight: _Sight, value: _Value) -> Noise:
    """The noise with its autoregression refitted to what draws of the delays leave."""
    rng = np.random.default_rng(0)  # stands in for an integral; the same draws every time
    signs = rng.choice([-1.0, 1.0], size=(value.mean.size, _DRAWS))
    around = dtbtrs(value.factor, signs, uplo="L", trans="T")[0] * value.sd_s
    draws = value.mean[:, None] + np.concatenate([around, -around], axis=1)
    left = [
        [s.left(value.noise.refit) - spread(s.response.late * x[:, None], s.response.first)]
        for draw in draws.T
        for s, x in zip(sight.heard.stretches, sight.heard.by_recording(draw), strict=True)
    ]
    R = len(sight.heard.stretches)
    series = [sum(left[r::R], []) for r in range(R)]
    old, new = value.noise.autoregression, sight.heard.refitted(value.noise, series)
    return replace(new, autoregression=old + _OVERSTEP * (new.autoregression - old))


def _about(heard: Heard, value: _Value) -> Heard:
    """The joint with its responses linearised about the posterior mean of the delays."""
    most = value.sd_s * np.sqrt(3)
    stretches = []
    for s, mean in zip(heard.stretches, heard.by_recording(value.mean), strict=True):
        delay = np.clip(mean, -min(most, EARLIEST_S), most)
        angle, late = s.response.late_by(delay)
        linear = spread(late * delay[:, None], s.response.first)
        response = replace(s.response, late=late)
        stretches.append(replace(s, residual=s.residual - angle + linear, response=response))
    return replace(heard, stretches=tuple(stretches))
