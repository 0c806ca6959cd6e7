"""What counts in a swim: errors in blocks of time and bands of frequency, each with its own size.

A twin that is a tenth wrong of how much the head swings is wrong at the beat, for as long as the
robot swims, and says nothing of a current; one whose drag is off is wrong of the mean. So an error
is taken apart by a cosine transform of each block of some 2.5 s, which is orthonormal, and each
coefficient's variance is that of the recording's noise and a share, by signal and band, of what the
signal itself has there: the twin's error, as it was measured (``law_error.json``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d

from sim.inference.swims import PoseNoise, Swim
from sim2real.velocity import body_velocity

Array = NDArray[np.float64]

BLOCK_S = 2.5
BANDS_HZ = (0.35, 1.8)
"""Between slow, beat and fast."""
_LEAK = 0.003
"""Of a block's whole power that every frequency of it has."""
_DRAWS = 12
_STEP_RAD = 0.0012
"""Noise of a joint's angle that rounding leaves, at least."""


def bounds(samples: int, period_s: float) -> list[tuple[int, int]]:
    """Where blocks begin and end."""
    count = max(1, round(samples * period_s / BLOCK_S))
    edges = np.linspace(0, samples, count + 1).round().astype(int)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def spectrum(signals: Array, edges: Sequence[tuple[int, int]]) -> Array:
    """Cosine transforms of blocks of signals (..., T, K), along T; orthonormal."""
    parts = [dct(signals[..., a:b, :], type=2, norm="ortho", axis=-2) for a, b in edges]
    return np.concatenate(parts, axis=-2)


def _about(coefficients: Array, edges: Sequence[tuple[int, int]]) -> Array:
    square = coefficients**2
    power = np.empty_like(square)
    for a, b in edges:
        wide = uniform_filter1d(square[a:b], 5, axis=0, mode="nearest")
        power[a:b] = wide + _LEAK * square[a:b].mean(axis=0)
    return power


@dataclass(frozen=True)
class Blocks:
    """One swim, as errors count in it.

    Attributes:
        edges: Of the blocks, in samples.
        block: Block of each coefficient, shape (T,).
        band: Its band, shape (T,): 0, 1 or 2.
        noise: Variance of the recording's noise in each coefficient, shape (T, K).
        power: Of the signals about each coefficient, shape (T, K).
        seen: Cosine transform of the recorded signals, shape (T, K).
    """

    edges: tuple[tuple[int, int], ...]
    block: NDArray[np.intp]
    band: NDArray[np.intp]
    noise: Array
    power: Array
    seen: Array

    @classmethod
    def of(cls, swim: Swim) -> Blocks:
        """From a recording."""
        period = float(swim.t[1] - swim.t[0])
        edges = bounds(swim.t.size, period)
        sizes = [b - a for a, b in edges]
        block = np.repeat(np.arange(len(edges)), sizes)
        hertz = np.concatenate([np.arange(n) / (2 * n * period) for n in sizes])
        signals = np.nan_to_num(swim.signals)
        seen = spectrum(signals, edges)
        power = _about(seen, edges)
        rng = np.random.default_rng(0)
        jitter = swim.shaken or PoseNoise(np.zeros(3))
        drawn = jitter.drawn(rng, (_DRAWS, swim.t.size), period)
        shaken = body_velocity(swim.t, drawn)
        noise = np.empty_like(seen)
        each = (spectrum(shaken, edges) ** 2).mean(axis=0)
        for a, b in edges:
            noise[a:b, :3] = uniform_filter1d(each[a:b], 9, axis=0, mode="nearest")
        noise[:, 3:] = np.broadcast_to(swim.noise, signals.shape[1])[3:] ** 2 + _STEP_RAD**2
        return cls(tuple(edges), block, np.searchsorted(BANDS_HZ, hertz), noise, power, seen)

    def weights(self, shares: Array, more: Array | float = 0.0) -> Array:
        """One over standard deviations (T, K) with the twin's error by signal and band, (4, 3).

        The last row of ``shares`` is that of joints; ``more`` is variance beside, (T, K).
        """
        K = self.noise.shape[1]
        rows = np.minimum(np.arange(K), 3)
        share = shares[rows][:, self.band].T
        return np.asarray(1 / np.sqrt(self.noise + share**2 * self.power + more + 1e-12))

    def about(self, signals: Array) -> Array:
        """Power of signals (T, K) about each coefficient, shape (T, K)."""
        return _about(spectrum(np.nan_to_num(signals), self.edges), self.edges)

    def errors(self, signals: Array) -> Array:
        """Cosine transforms of simulated minus recorded signals, (..., T, K)."""
        return spectrum(np.nan_to_num(signals, nan=10.0), self.edges) - self.seen
