"""The noise of an angle: autoregressive, and of another size at rest than in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sim2real.diagnose.arrival_response import Residual, Response, response

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

RATIOS = (0.1, 10.0)
"""Smallest and largest noise at rest, relative to that in motion."""
LEAST_SD_RAD = 1e-9
_REST_SHARES = np.linspace(0.1, 0.8, 8)
"""Shares of the samples, the slowest, that may be called at rest."""
_NEAR = np.array([2e-4, 0.01, 0.01])
"""Changes of latency in s and of the logarithms of kd and kp that are linear in their effect."""
_FEWEST = 100
"""Samples on which a size of noise is founded."""
_ITERATIONS, _MOVES = 20, 3


@dataclass(frozen=True)
class Stretch:
    """One recording of one joint, as the likelihoods need it.

    Attributes:
        given: The recording.
        response: What single set-points do.
        residual: Simulated minus measured angle in rad, 0 where not used, shape (T,).
        counts: Samples that count: used, as are the p before them, shape (T,).
        rests: Samples at rest, shape (T,).
    """

    given: Residual
    response: Response
    residual: Array
    counts: Mask
    rests: Mask

    def weight(self, ratio: float) -> Array:
        """One over the size of the noise relative to that in motion, 0 where not counted, (T,)."""
        return np.where(self.counts, np.where(self.rests, 1 / ratio, 1.0), 0.0)

    def left(self, refit: Array) -> Array:
        """Residual after a change of latency, kd and kp by ``refit`` (3,), shape (T,)."""
        return self.residual - self.response.refit @ refit


@dataclass(frozen=True)
class Noise:
    """Autoregressive noise with innovations of two sizes.

    Attributes:
        autoregression: Coefficients, shape (p,).
        ratio: Standard deviation of the innovations at rest, relative to those in motion.
        variance: Of the innovations in motion, in rad2.
        refit: How far the latency in s and the logarithms of kd and kp are too large, shape (3,).
    """

    autoregression: Array
    ratio: float
    variance: float
    refit: Array


@dataclass(frozen=True)
class Heard:
    """All recordings of one joint, and the noise that best explains them alone.

    Attributes:
        stretches: The recordings.
        noise: The noise.
        least_gain: Least gain of the whitening filter at frequency 0.
    """

    stretches: tuple[Stretch, ...]
    noise: Noise
    least_gain: float

    @property
    def lags(self) -> int:
        """Order p of the autoregression."""
        return self.noise.autoregression.size

    @cached_property
    def counts(self) -> tuple[int, int]:
        """Samples that count, and those of them at rest."""
        every = sum(int(s.counts.sum()) for s in self.stretches)
        return every, sum(int((s.counts & s.rests).sum()) for s in self.stretches)

    def by_recording(self, values: Array) -> list[Array]:
        """One number a set-point (K,), cut into recordings."""
        ends = np.cumsum([s.residual.size for s in self.stretches])[:-1]
        return np.split(values, ends)

    def variance(self, error2: float) -> float:
        """Likeliest variance of the innovations in motion, in rad2, for ``loglikelihood``."""
        return max(error2 / self.counts[0], LEAST_SD_RAD**2)

    def loglikelihood(self, error2: float, ratio: float) -> float:
        """Gaussian log-likelihood, its variance at its best, up to a constant.

        Args:
            error2: Weighted sum of squared innovations in rad2.
            ratio: See ``Noise``.
        """
        every, rest = self.counts
        return -0.5 * every * float(np.log(self.variance(error2))) - rest * float(np.log(ratio))

    def alone(self, noise: Noise) -> float:
        """Log-likelihood of the residual as noise, its variance and ``refit`` at their best."""
        return self.loglikelihood(_weighted(self, noise)[1], noise.ratio)

    def moved(self, refit: Array) -> Heard:
        """The joint about the latency, kd and kp that leave nothing of ``refit``.

        Args:
            refit: See ``Noise``; nothing is done for so little that it acts linearly.
        """
        if (np.abs(refit) < _NEAR).all():
            return self
        stretches = []
        for s in self.stretches:
            given = s.given.moved(-refit)
            residual = np.where(given.used, given.residual, 0.0)
            stretches.append(Stretch(given, response(given), residual, s.counts, s.rests))
        return replace(self, stretches=tuple(stretches))

    def refitted(self, noise: Noise, series: Sequence[Sequence[Array]]) -> Noise:
        """The noise with its autoregression refitted to ``series``, as ``fit_autoregression``."""
        weights = [s.weight(noise.ratio) for s in self.stretches]
        fitted = fit_autoregression(series, weights, self.lags, self.least_gain)
        return replace(noise, autoregression=fitted)


def hear(given: Sequence[Residual], lags: int, least_gain: float) -> Heard:
    """Fit the noise of one joint by maximum likelihood, with nothing random on its set-points.

    Innovations are smaller at rest where the sensor is coarser than its noise. Were that not
    allowed for, larger innovations in motion would be taken for set-points that come unevenly.

    Args:
        given: Its recordings.
        lags: Order p of the autoregression.
        least_gain: Least gain of the whitening filter at frequency 0.

    Raises:
        ValueError: If no more samples count than the autoregression has coefficients.
    """
    stretches = tuple(_stretch(one, lags) for one in given)
    start = Noise(np.zeros(lags), 1.0, 1.0, np.zeros(3))
    heard = Heard(stretches, start, least_gain)
    if heard.counts[0] <= lags:
        raise ValueError(f"{heard.counts[0]} samples count; {lags} lags take more")
    heard = replace(heard, noise=heard.refitted(start, [[s.residual] for s in stretches]))
    heard = _fitted(replace(heard, stretches=_with_rest(heard)))
    for _ in range(_MOVES):
        again = heard.moved(heard.noise.refit)
        if again is heard:
            break
        again = _fitted(again)
        if again.alone(again.noise) < heard.alone(heard.noise):
            break
        heard = again
    return heard


def _fitted(heard: Heard) -> Heard:
    """The joint with its noise at its likeliest."""
    noise, before = heard.noise, -np.inf
    for _ in range(_ITERATIONS):
        noise, value = _improved(heard, noise)
        if value < before + 0.01:
            break
        before = value
        noise = heard.refitted(noise, [[s.left(noise.refit)] for s in heard.stretches])
    return replace(heard, noise=noise)


def ratio_of(heard: Heard, innovations: Sequence[Array]) -> float:
    """Size of innovations (T,) at rest relative to those in motion."""
    pairs = list(zip(heard.stretches, innovations, strict=True))
    rest = np.concatenate([e[s.counts & s.rests] for s, e in pairs])
    moving = np.concatenate([e[s.counts & ~s.rests] for s, e in pairs])
    if not rest.size or not moving.any():
        return 1.0
    return float(np.clip(np.sqrt(np.mean(rest**2) / np.mean(moving**2)), *RATIOS))


def whiten(values: Array, autoregression: Array) -> Array:
    """Innovations of the columns of ``values`` (T, ...), wrong for the first p."""
    out = values.copy()
    for k, a in enumerate(autoregression, start=1):
        out[k:] -= a * values[:-k]
    return out


def fit_autoregression(
    series: Sequence[Sequence[Array]], weights: Sequence[Array], lags: int, least_gain: float
) -> Array:
    """Coefficients by weighted least squares, shape (p,).

    They add up to at most ``1 - least_gain``.

    Args:
        series: For each recording one or more equally likely noises, each of shape (T,).
        weights: Square roots of the weights of the samples of each recording, each (T,).
        lags: p.
        least_gain: Least gain of the whitening filter at frequency 0.
    """
    products = np.zeros((lags + 1, lags + 1))
    for some, weight in zip(series, weights, strict=True):
        root = weight[lags:, None]
        for one in some:
            windows = sliding_window_view(one, lags + 1)[:, ::-1] * root
            products += windows.T @ windows / len(some)
    past, now = products[1:, 1:].copy(), products[1:, 0]
    past += (1e-9 * np.trace(past) / lags + 1e-30) * np.eye(lags)
    free, ones = np.linalg.solve(past, np.stack([now, np.ones(lags)], axis=1)).T
    excess = max(float(free.sum()) - (1 - least_gain), 0.0)
    return np.asarray(free - excess / ones.sum() * ones)


def regress(products: Array) -> tuple[Array, float]:
    """Best ``refit`` (3,) and what it leaves of the first variable's square.

    Args:
        products: Inner products of the residual and the columns of ``refit``, shape (4, 4).
    """
    normal = products[1:, 1:]
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size) + 1e-10 * np.eye(3)
    refit = np.linalg.solve(scaled, products[1:, 0] / size) / size
    return refit, float(products[0, 0] - products[0, 1:] @ refit)


def _stretch(given: Residual, lags: int) -> Stretch:
    missing = np.cumsum(np.concatenate([np.zeros(lags + 1), ~given.used]))
    counts = missing[lags + 1 :] == missing[: -lags - 1]
    counts[:lags] = False
    residual = np.where(given.used, given.residual, 0.0)
    return Stretch(given, response(given), residual, counts, np.zeros(counts.size, dtype=bool))


def _with_rest(heard: Heard) -> tuple[Stretch, ...]:
    """The recordings with the speed below which a sample rests at its likeliest."""
    a, stretches = heard.noise.autoregression, heard.stretches
    square = np.concatenate([whiten(s.residual, a)[s.counts] ** 2 for s in stretches])
    speed = np.concatenate([s.response.speed[s.counts] for s in stretches])
    best, limit = square.size * np.log(square.mean() + 1e-300), -1.0
    for trial in np.quantile(speed, _REST_SHARES):
        rests = speed <= trial
        if min(rests.sum(), (~rests).sum()) < _FEWEST:
            continue
        moving = square[~rests].mean() + 1e-300
        rest = np.clip(square[rests].mean() / moving, RATIOS[0] ** 2, RATIOS[1] ** 2) * moving
        excess = rests.sum() * (square[rests].mean() / rest - 1)
        value = rests.sum() * np.log(rest) + (~rests).sum() * np.log(moving) + excess
        if value < best:
            best, limit = value, float(trial)
    return tuple(replace(s, rests=s.response.speed <= limit) for s in stretches)


def _improved(heard: Heard, noise: Noise) -> tuple[Noise, float]:
    """The noise with its sizes and ``refit`` at their best, and its log-likelihood."""
    a = noise.autoregression
    ratio = ratio_of(heard, [whiten(s.left(noise.refit), a) for s in heard.stretches])
    refit, error2 = _weighted(heard, replace(noise, ratio=ratio))
    return Noise(a, ratio, heard.variance(error2), refit), heard.loglikelihood(error2, ratio)


def _weighted(heard: Heard, noise: Noise) -> tuple[Array, float]:
    """Best ``refit`` (3,) and the weighted sum of squared innovations that it leaves, in rad2."""
    products = np.zeros((4, 4))
    for s in heard.stretches:
        columns = np.column_stack([s.residual, s.response.refit])
        columns = whiten(columns, noise.autoregression) * s.weight(noise.ratio)[:, None]
        products += columns.T @ columns
    return regress(products)
