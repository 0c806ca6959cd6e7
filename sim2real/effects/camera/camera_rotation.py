"""The axes of the camera are rotated relative to the pool's.

Positions are rotated by ``angle_rad`` about the pool's origin; headings are not.

Confused with: a lateral current.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import Array, CameraEffect
from sim2real.inference.parameters import Parameter


def see(_t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as measured by the camera."""
    c, s = np.cos(p["angle_rad"]), np.sin(p["angle_rad"])
    x, y, heading = pose.T
    return np.stack([c * x - s * y, s * x + c * y, heading], axis=1)


EFFECT = CameraEffect(
    name="camera_rotation",
    plain="a rotated camera",
    title="rotation of the camera's axes relative to the pool's, headings excepted",
    parameters=(Parameter("angle_rad", low=-0.8, high=0.8, typical=0.03),),
    see=see,
    order=4,
)
