"""What camera and servos show: poses and angles with noise, angles in the servo's steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NOISE = {"position_m": 0.002, "heading_rad": 0.009, "joint_rad": 0.0015}
STEP_RAD = 0.00419


def filmed(pose: Array, rng: np.random.Generator) -> Array:
    """Poses as an overhead camera shows them, shape (n, 3)."""
    shown = pose.copy()
    shown[:, :2] += NOISE["position_m"] * rng.standard_normal((len(pose), 2))
    shown[:, 2] += NOISE["heading_rad"] * rng.standard_normal(len(pose))
    return shown


def reported(angle: Array, rng: np.random.Generator) -> Array:
    """Angles as the servos report them, shape (n, J)."""
    noisy = angle + NOISE["joint_rad"] * rng.standard_normal(angle.shape)
    return np.asarray(np.round(noisy / STEP_RAD) * STEP_RAD)
