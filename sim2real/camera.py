"""Measured poses of a camera above the pool, with the camera effects of the catalogue."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import CAMERA

Array = NDArray[np.float64]


def observed(t: Array, pose: Array, parameters: Mapping[str, float]) -> Array:
    """Poses as measured by the camera.

    Args:
        t: Times in s, shape (T,), increasing and evenly spaced.
        pose: x, y in m and heading in rad of the head's centre of mass, shape (T, 3).
        parameters: Parameters of camera effects by ``effect.parameter``; others are ignored.

    Returns:
        Poses, shape (T, 3).
    """
    out = np.array(pose, dtype=np.float64)
    for effect in CAMERA:
        values = {p.name: parameters.get(f"{effect.name}.{p.name}", 0.0) for p in effect.parameters}
        if any(values.values()):
            out = effect.see(t, out, values)
    return out
