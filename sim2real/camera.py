"""What a camera above the pool makes of the true poses: the catalogue's camera effects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def observed(t: Array, pose: Array, parameters: Mapping[str, float]) -> Array:
    """Poses as the camera gives them.

    Args:
        t: Times in s, shape (T,), increasing and even.
        pose: x, y in m and heading in rad of the head's centre of mass, shape (T, 3).
        parameters: Of camera effects by ``effect.parameter``; others are ignored.

    Returns:
        Poses, shape (T, 3). Lost frames repeat the last pose: on average the poses are late by
        p / (1 - p) frames, which is what is applied, so that the result is a smooth function of p.
    """
    get = parameters.get
    out = np.array(pose, dtype=np.float64)
    ahead, left = get("marker_offset.x_m", 0.0), get("marker_offset.y_m", 0.0)
    if ahead or left:
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        out[:, 0] += ahead * c - left * s
        out[:, 1] += ahead * s + left * c
    period = float(np.median(np.diff(t)))
    lost = min(get("dropped_frames.probability", 0.0), 0.9)
    late = get("camera_latency.latency_s", 0.0) + period * lost / (1 - lost)
    if late:
        out = np.stack([np.interp(t - late, t, column) for column in out.T], axis=1)
    time = get("pose_filter.time_constant_s", 0.0)
    if time > 0:
        kept = float(np.exp(-period / time))
        first = out[0].copy()
        out = first + lfilter([1 - kept], [1, -kept], out - first, axis=0)
    angle = get("camera_rotation.angle_rad", 0.0)
    if angle:
        c, s = np.cos(angle), np.sin(angle)
        out[:, :2] = np.stack([c * out[:, 0] - s * out[:, 1], s * out[:, 0] + c * out[:, 1]], 1)
    out[:, :2] *= 1 + get("camera_scale.ratio", 0.0)
    return out
