"""The axes of the camera are rotated relative to the pool's.

Positions are rotated by ``angle_rad`` about the pool's origin; headings are not. Confused with: a
lateral current.
"""

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.body_effect import CameraEffect, Parameter, Values


def _see(_t: Array, pose: Array, p: Values) -> Array:
    c, s = np.cos(p["angle_rad"]), np.sin(p["angle_rad"])
    x, y, heading = pose.T
    return np.stack([c * x - s * y, s * x + c * y, heading], axis=1)


EFFECT = CameraEffect(
    plain="a rotated camera",
    title="rotation of the camera's axes relative to the pool's, headings excepted",
    parameters=(Parameter("angle_rad", low=-0.8, high=0.8, typical=0.03),),
    see=_see,
    order=4,
)
