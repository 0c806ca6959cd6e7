"""The camera's metres are too long or too short by this share.

``position (1 + ratio)``.

Taken for: a slower or a faster robot; a ruler in the picture tells.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import Array, BodyParameter, CameraEffect


def see(_t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as the camera gives them."""
    return pose * np.array([1 + p["ratio"], 1 + p["ratio"], 1.0])


EFFECT = CameraEffect(
    name="camera_scale",
    plain="a camera whose scale is off",
    title="the camera's metres are too long or too short by this share",
    parameters=(BodyParameter("ratio", "", 0.02, -0.3, 0.3),),
    see=see,
    order=5,
)
