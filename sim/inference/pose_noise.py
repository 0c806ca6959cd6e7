"""Noise of measured poses: its size, and whether a filter smoothed it.

At 9 Hz and above the poses hold only noise. White noise is equal at all frequencies; a filter's
time constant is estimated from them (Whittle's likelihood: J. R. Stat. Soc. B 15 (1953) 125).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from sim2real.arrays import Array

ABOVE_HZ = 9.0
LAGS_S: Array = np.concatenate([[0.0], np.geomspace(0.004, 0.4, 60)])
"""Time constants of the filter that are compared."""
_LONGEST_S = 0.05
"""Longest time constant that is reported: high frequencies do not distinguish longer ones."""
_SURE, _MOST = 5.0, 60.0
"""Log-likelihood ratio from which noise counts as smoothed, and its largest value."""
_LEAST = 64
"""Least number of frequencies for an estimate."""


@dataclass(frozen=True)
class PoseNoise:
    """Noise of x, y and heading."""

    sd: Array  # standard deviation before the filter, shape (3,)
    lag_s: float = 0.0  # time constant of the filter; 0 without a filter
    # log-likelihood ratio of each of ``LAGS_S`` to white noise; None where poses were resampled or
    # lost, which smooths them too
    colour: Array | None = None

    def log_ratio(self, lag_s: float) -> float:
        """Log-likelihood ratio of a filter with this time constant to white noise."""
        return 0.0 if self.colour is None else float(np.interp(lag_s, LAGS_S, self.colour))

    def drawn(self, rng: np.random.Generator, shape: tuple[int, ...], period_s: float) -> Array:
        """Random samples of this noise, shape (..., T, 3)."""
        white = rng.standard_normal((*shape, 3)) * self.sd
        weight = _filter_weight(self.lag_s, period_s)
        state = white[..., :1, :] * weight
        out, _ = lfilter([1 - weight], [1, -weight], white, axis=-2, zi=state)
        return np.asarray(out)


def _filter_weight(lag_s: float, period_s: float) -> float:
    """Weight of the previous output in a first-order filter."""
    return float(np.exp(-period_s / lag_s)) if lag_s > 0 else 0.0


def pose_noise(poses: Array, period_s: float) -> PoseNoise | None:
    """Noise of poses (T, 3) at regular intervals, by third differences; None if they are few."""
    third = np.diff(poses, 3, axis=0)
    window = np.hanning(len(third))[:, None]
    hertz = np.fft.rfftfreq(len(third), period_s)
    high = hertz > ABOVE_HZ
    if high.sum() < _LEAST:
        return None
    angle = 2 * np.pi * period_s * hertz[high]
    power = np.abs(np.fft.rfft(third * window, axis=0)[high]) ** 2 / np.sum(window**2)
    flat = power / (2 * np.sin(angle / 2))[:, None] ** 6
    weight = np.array([[_filter_weight(lag, period_s)] for lag in LAGS_S])
    response = (1 - weight) ** 2 / (1 + weight**2 - 2 * weight * np.cos(angle))
    square = np.mean(flat / response[:, :, None], axis=1)
    log_power = np.log(square).sum(axis=1) * angle.size + 3 * np.log(response).sum(axis=1)
    # the window correlates neighbouring frequencies: about two thirds are independent
    log_ratio = -2 / 3 * (log_power - log_power[0])
    # longer time constants differ in the size of the noise only
    longest = np.searchsorted(LAGS_S, _LONGEST_S, side="right") - 1
    best = min(int(np.argmax(log_ratio)), int(longest)) if log_ratio.max() >= _SURE else 0
    colour = np.clip(log_ratio, -_MOST, _MOST)
    return PoseNoise(np.sqrt(square[best]), float(LAGS_S[best]), colour)
