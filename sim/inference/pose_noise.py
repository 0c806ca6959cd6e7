"""The noise of poses: how large it is, and whether something has smoothed it.

Nothing of a robot moves at 9 Hz and above but the noise. White noise is as large at all
frequencies; a filter of poses smooths their noise as well, and so shows itself there, whatever the
robot does (Whittle's likelihood: J. R. Stat. Soc. B 15 (1953) 125).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

ABOVE_HZ = 9.0
LAGS_S: Array = np.concatenate([[0.0], np.geomspace(0.004, 0.4, 60)])
"""Time constants that are tried."""
_LONGEST_S = 0.05
"""Of longer time constants only this is said: high frequencies show no difference."""
_SURE, _MOST = 5.0, 60.0
"""Log-likelihood from which noise counts as smoothed, and the most that it may bring."""
_LEAST = 64
"""Frequencies that are needed to say anything."""


@dataclass(frozen=True)
class PoseNoise:
    """Noise of x, y and heading.

    Attributes:
        sd: As it went into the filter, shape (3,).
        lag_s: Time constant of the filter; 0 where there is none.
        colour: Log-likelihood at each of ``LAGS_S`` above that of white noise; None where poses
            were resampled or lost, which smooths them too.
    """

    sd: Array
    lag_s: float = 0.0
    colour: Array | None = None

    def told(self, lag_s: float) -> float:
        """What the noise says of a filter with this time constant: a log-likelihood ratio."""
        return 0.0 if self.colour is None else float(np.interp(lag_s, LAGS_S, self.colour))

    def drawn(self, rng: np.random.Generator, shape: tuple[int, ...], period_s: float) -> Array:
        """Noise like it, shape (..., T, 3)."""
        white = rng.standard_normal((*shape, 3)) * self.sd
        kept = _kept(self.lag_s, period_s)
        if kept == 0.0:
            return np.asarray(white)
        begun = np.take(white, [0], axis=-2) * kept
        out, _ = lfilter([1 - kept], [1, -kept], white, axis=-2, zi=begun)
        return np.asarray(out)


def _kept(lag_s: float, period_s: float) -> float:
    """Share of the last pose that a filter keeps."""
    return float(np.exp(-period_s / lag_s)) if lag_s > 0 else 0.0


def pose_noise(poses: Array, period_s: float) -> PoseNoise | None:
    """That of poses (T, 3) that were recorded evenly; None where they are too few.

    Third differences take away what moves slowly, so that it does not leak into high frequencies.
    """
    third = np.diff(poses, 3, axis=0)
    third = third * np.hanning(len(third))[:, None]
    hertz = np.fft.rfftfreq(len(third), period_s)
    high = hertz > ABOVE_HZ
    if high.sum() < _LEAST:
        return None
    angle = 2 * np.pi * period_s * hertz[high]
    power = np.abs(np.fft.rfft(third, axis=0)[high]) ** 2 / np.sum(np.hanning(len(third)) ** 2)
    flat = power / (2 * np.sin(angle / 2))[:, None] ** 6
    # a window makes neighbours alike: some two thirds of the frequencies count
    worth = 2 / 3
    likelihood, sizes = [], []
    for lag in LAGS_S:
        kept = _kept(lag, period_s)
        response = (1 - kept) ** 2 / (1 + kept**2 - 2 * kept * np.cos(angle))
        square = np.mean(flat / response[:, None], axis=0)
        sizes.append(np.sqrt(square))
        each = np.log(square) * len(angle) + np.log(response).sum()
        likelihood.append(-worth * float(each.sum()))
    found = np.array(likelihood) - likelihood[0]
    best = int(np.argmax(found))
    if found[best] < _SURE:
        best = 0
    while LAGS_S[best] > _LONGEST_S:  # from here on all are alike but for the noise's size
        best -= 1
    return PoseNoise(sizes[best], float(LAGS_S[best]), np.clip(found, -_MOST, _MOST))


__all__ = ["LAGS_S", "PoseNoise", "pose_noise"]
