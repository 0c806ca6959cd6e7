"""The positions of the camera have a relative scale error.

``position (1 + ratio)``.

Confused with: a slower or a faster robot; a ruler in the image distinguishes them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import Array, CameraEffect
from sim2real.inference.parameters import Parameter


def see(_t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as measured by the camera."""
    return pose * np.array([1 + p["ratio"], 1 + p["ratio"], 1.0])


EFFECT = CameraEffect(
    name="camera_scale",
    plain="a scale error of the camera",
    title="scale error of the camera's positions",
    parameters=(Parameter("ratio", low=-0.3, high=0.3, typical=0.02),),
    see=see,
    order=5,
)
