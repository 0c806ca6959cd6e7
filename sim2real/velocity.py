"""Estimators of body velocities from poses, for fits, figures and policies."""

import numpy as np
from scipy.signal import savgol_filter

from sim2real.arrays import Array

NEWEST = 5
"""Samples in the newest velocity: 0.08 s at 50 Hz, a delay of 0.04 s."""


def body_velocity(t: Array, pose: Array) -> Array:
    """Surge and sway in m/s, yaw rate in rad/s from poses in m and rad; both (..., T, 3).

    The slope of a parabola through a moving window of 0.22 s (Savitzky and Golay, Anal. Chem. 36
    (1964) 1627), rotated by the smoothed heading. Times ``t`` (T,) in s are assumed to be evenly
    spaced; missing poses are NaN, and interpolated.
    """
    period = float(np.median(np.diff(t)))
    odd = 2 * max(1, round(0.22 / period / 2)) + 1
    size = min(max(odd, 5), t.size - 1 + t.size % 2)
    filled = np.array(pose, dtype=np.float64)
    for place in np.ndindex(filled.shape[:-2]):
        for k, column in enumerate(filled[place].T):
            present = np.isfinite(column)
            if present.sum() < 5:
                raise ValueError(f"{present.sum()} poses, five are needed")
            values = np.unwrap(column[present]) if k == 2 else column[present]
            column[:] = values if present.all() else np.interp(t, t[present], values)
    slope = savgol_filter(filled, size, 2, deriv=1, delta=period, axis=-2)
    heading = savgol_filter(filled[..., 2], size, 2, axis=-1)
    return np.concatenate([turned(slope[..., :2], -heading), slope[..., 2:]], axis=-1)


def turned(vectors: Array, angle: Array) -> Array:
    """Vectors (..., 2) of the plane, turned anticlockwise by angles (...,) in rad."""
    c, s, (x, y) = np.cos(angle), np.sin(angle), np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def slope_weights(samples: int = NEWEST, period_s: float = 0.02) -> Array:
    """Weights of the last samples, oldest first, in the slope of the line through them."""
    place = np.arange(samples) - (samples - 1) / 2
    return np.asarray(place / (place @ place) / period_s)
