"""Errors of a swim's signals: their variances by band of frequency, and persistent shapes.

Each block of about 2.5 s is transformed by an orthonormal cosine transform. The variance of a
coefficient is that of the recording's noise plus a share of the signal's power: the error of the
twin. Errors that persist for seconds are columns of the fit, with one part common to all swims of a
robot and one for each swim (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001) 425).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d

from sim.inference.swims import Swim, block_bounds
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array, Index
from sim2real.velocity import body_velocity

ROWS, BANDS = ("surge", "sway", "yaw rate", "joints"), ("slow", "beat", "fast")
"""Signals and frequency bands of the error."""
BANDS_HZ = (0.35, 1.8)
"""Limits between the bands slow, beat and fast."""
SLOW = 51
"""Samples of the moving average that separates a signal's mean from its oscillation."""
_STEP_RAD = 0.0012
"""Least noise of a joint's angle, due to rounding."""


def spectrum(signals: Array, edges: Sequence[tuple[int, int]]) -> Array:
    """Cosine transforms of blocks of signals (..., T, K), along T; orthonormal."""
    parts = [dct(signals[..., a:b, :], type=2, norm="ortho", axis=-2) for a, b in edges]
    return np.concatenate(parts, axis=-2)


def _local_power(coefficients: Array, edges: Sequence[tuple[int, int]]) -> Array:
    """Power around each coefficient, and a share of the block's mean, which leaks everywhere."""
    squares = coefficients**2
    power = np.empty_like(squares)
    for a, b in edges:
        smooth = uniform_filter1d(squares[a:b], 5, axis=0, mode="nearest")
        power[a:b] = smooth + 0.003 * squares[a:b].mean(axis=0)
    return power


@dataclass(frozen=True)
class Blocks:
    """Cosine transform of one swim, and the variances of its coefficients."""

    edges: tuple[tuple[int, int], ...]  # first sample and end of each block
    block: Index  # block of each coefficient, shape (T,)
    band: Index  # its band, shape (T,): 0, 1 or 2
    noise: Array  # variance of the recording's noise in each coefficient, shape (T, K)
    power: Array  # power of the signals around each coefficient, shape (T, K)
    seen: Array  # cosine transform of the recorded signals, shape (T, K)

    @classmethod
    def of(cls, swim: Swim) -> Blocks:
        """The blocks of a recording; the noise of its velocities is that of drawn samples."""
        period = float(swim.t[1] - swim.t[0])
        edges = tuple(block_bounds(swim.t.size, period))
        sizes = [b - a for a, b in edges]
        hertz = np.concatenate([np.arange(n) / (2 * n * period) for n in sizes])
        transformed = spectrum(np.nan_to_num(swim.signals), edges)
        samples = swim.pose_noise.drawn(np.random.default_rng(0), (12, swim.t.size), period)
        noise_power = (spectrum(body_velocity(swim.t, samples), edges) ** 2).mean(axis=0)
        noise = np.empty_like(transformed)
        for a, b in edges:
            noise[a:b, :3] = uniform_filter1d(noise_power[a:b], 9, axis=0, mode="nearest")
        noise[:, 3:] = swim.noise_sd[3:] ** 2 + _STEP_RAD**2
        noise[:, np.isnan(swim.signals).all(axis=0)] = np.inf  # not measured
        block, band = np.repeat(np.arange(len(edges)), sizes), np.searchsorted(BANDS_HZ, hertz)
        return cls(edges, block, band, noise, _local_power(transformed, edges), transformed)

    def weights(self, shares: Array) -> Array:
        """Reciprocal sd (T, K), with the twin's error by signal (joints last) and band (4, 3)."""
        rows = np.minimum(np.arange(self.noise.shape[1]), 3)
        share = shares[rows][:, self.band].T
        return np.asarray(1 / np.sqrt(self.noise + share**2 * self.power + 1e-12))

    def about(self, signals: Array) -> Array:
        """Power of signals (T, K) around each coefficient, shape (T, K)."""
        return _local_power(spectrum(np.nan_to_num(signals), self.edges), self.edges)

    def errors(self, signals: Array) -> Array:
        """Cosine transforms of simulated minus recorded signals, (..., T, K)."""
        return spectrum(np.nan_to_num(signals, nan=10.0), self.edges) - self.seen

    def in_time(self, coefficients: Array) -> Array:
        """The signals (T, K) with these cosine transforms."""
        parts = [dct(coefficients[a:b], type=3, norm="ortho", axis=0) for a, b in self.edges]
        return np.concatenate(parts)

    def weighted(self, signals: Array, weights: Array) -> Array:
        """Columns (m, T, K) of signals, transformed and weighted as in a fit, shape (T K, m)."""
        return np.asarray((spectrum(signals, self.edges) * weights).reshape(len(signals), -1).T)


def kinds_of(joints: int) -> dict[str, tuple[int, str]]:
    """Of each shape of a robot's error, by name, the number of its signal and its kind."""
    kinds: dict[str, tuple[str, ...]] = {
        "surge_": ("0", "1", "2", "3", "swing", "late"),
        "sway_": ("swing", "late", "off"),
        "yaw_": ("swing", "late", "slow", "off", "off_1"),
    }
    kinds |= {f"joint{j}.": ("swing", "late", "off") for j in range(joints)}
    places = enumerate(kinds.items())
    return {f"error.{of}{kind}": (k, kind) for k, (of, some) in places for kind in some}


def shapes(signals: Array) -> dict[str, Array]:
    """Shapes of unit size for the signals (T, 3 + J) of a simulated swim, by name.

    Sizes are relative errors, delays in s, or offsets in the signal's unit. They are computed from
    simulated signals: the noise of recorded ones would seem to explain itself.
    """
    T, K = signals.shape
    slow = uniform_filter1d(signals, SLOW, axis=0, mode="nearest")
    swing = signals - slow
    polynomials = legvander(np.linspace(-1.0, 1.0, T), 3).T[:, :, None]
    of_kind = {"swing": swing, "late": -np.gradient(swing, CONTROL_S, axis=0), "slow": slow}
    of_kind |= {"off": polynomials[0], "off_1": polynomials[1]}
    of_kind |= {str(n): wave * slow for n, wave in enumerate(polynomials)}
    out = {}
    for name, (k, kind) in kinds_of(K - 3).items():
        out[name] = np.zeros((T, K))
        out[name][:, k] = np.broadcast_to(of_kind[kind], (T, K))[:, k]
    return out
