"""Errors of a swim in blocks of time and bands of frequency, each with its own variance.

An error of the head's swing is at the beat frequency and carries no information about a current; an
error of the drag is in the mean. So each block of about 2.5 s is transformed by an orthonormal
cosine transform. The variance of a coefficient is that of the recording's noise plus a share, by
signal and band, of the signal's power: the measured error of the twin (``law_error.json``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d

from sim.inference.swims import PoseNoise, Swim
from sim2real.arrays import Array, Index
from sim2real.velocity import body_velocity

BLOCK_S = 2.5
BANDS_HZ = (0.35, 1.8)
"""Limits between the bands slow, beat and fast."""
_LEAK = 0.003
"""Share of a block's mean power that is added at every frequency (spectral leakage)."""
_DRAWS = 12
_STEP_RAD = 0.0012
"""Least noise of a joint's angle, due to rounding."""


def bounds(samples: int, period_s: float) -> list[tuple[int, int]]:
    """First sample and end of each block."""
    count = max(1, round(samples * period_s / BLOCK_S))
    edges = np.linspace(0, samples, count + 1).round().astype(int)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def spectrum(signals: Array, edges: Sequence[tuple[int, int]]) -> Array:
    """Cosine transforms of blocks of signals (..., T, K), along T; orthonormal."""
    parts = [dct(signals[..., a:b, :], type=2, norm="ortho", axis=-2) for a, b in edges]
    return np.concatenate(parts, axis=-2)


def _local_power(coefficients: Array, edges: Sequence[tuple[int, int]]) -> Array:
    squares = coefficients**2
    power = np.empty_like(squares)
    for a, b in edges:
        smooth = uniform_filter1d(squares[a:b], 5, axis=0, mode="nearest")
        power[a:b] = smooth + _LEAK * squares[a:b].mean(axis=0)
    return power


@dataclass(frozen=True)
class Blocks:
    """Cosine transform of one swim, and the variances of its coefficients.

    Attributes:
        edges: First sample and end of each block.
        block: Block of each coefficient, shape (T,).
        band: Its band, shape (T,): 0, 1 or 2.
        noise: Variance of the recording's noise in each coefficient, shape (T, K).
        power: Power of the signals around each coefficient, shape (T, K).
        seen: Cosine transform of the recorded signals, shape (T, K).
    """

    edges: tuple[tuple[int, int], ...]
    block: Index
    band: Index
    noise: Array
    power: Array
    seen: Array

    @classmethod
    def of(cls, swim: Swim) -> Blocks:
        """The blocks of a recording."""
        period = float(swim.t[1] - swim.t[0])
        edges = bounds(swim.t.size, period)
        sizes = [b - a for a, b in edges]
        block = np.repeat(np.arange(len(edges)), sizes)
        hertz = np.concatenate([np.arange(n) / (2 * n * period) for n in sizes])
        signals = np.nan_to_num(swim.signals)
        transformed = spectrum(signals, edges)
        power = _local_power(transformed, edges)
        rng = np.random.default_rng(0)
        pose_noise = swim.pose_noise or PoseNoise(np.zeros(3))
        samples = pose_noise.drawn(rng, (_DRAWS, swim.t.size), period)
        velocity_noise = body_velocity(swim.t, samples)
        noise = np.empty_like(transformed)
        noise_power = (spectrum(velocity_noise, edges) ** 2).mean(axis=0)
        for a, b in edges:
            noise[a:b, :3] = uniform_filter1d(noise_power[a:b], 9, axis=0, mode="nearest")
        noise[:, 3:] = np.broadcast_to(swim.noise, signals.shape[1])[3:] ** 2 + _STEP_RAD**2
        return cls(tuple(edges), block, np.searchsorted(BANDS_HZ, hertz), noise, power, transformed)

    def weights(self, shares: Array, more: Array | float = 0.0) -> Array:
        """Reciprocal standard deviations (T, K), with the twin's error by signal and band, (4, 3).

        The last row of ``shares`` is that of joints; ``more`` is additional variance, (T, K).
        """
        K = self.noise.shape[1]
        rows = np.minimum(np.arange(K), 3)
        share = shares[rows][:, self.band].T
        return np.asarray(1 / np.sqrt(self.noise + share**2 * self.power + more + 1e-12))

    def about(self, signals: Array) -> Array:
        """Power of signals (T, K) around each coefficient, shape (T, K)."""
        return _local_power(spectrum(np.nan_to_num(signals), self.edges), self.edges)

    def errors(self, signals: Array) -> Array:
        """Cosine transforms of simulated minus recorded signals, (..., T, K)."""
        return spectrum(np.nan_to_num(signals, nan=10.0), self.edges) - self.seen
