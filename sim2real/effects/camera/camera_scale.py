"""The positions of the camera have a relative scale error.

``position (1 + ratio)``.

Confused with: a slower or a faster robot; a ruler in the image distinguishes them.
"""

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.body_effect import CameraEffect, Parameter, Values


def _see(_t: Array, pose: Array, p: Values) -> Array:
    return pose * np.array([1 + p["ratio"], 1 + p["ratio"], 1.0])


EFFECT = CameraEffect(
    plain="a scale error of the camera",
    title="scale error of the camera's positions",
    parameters=(Parameter("ratio", low=-0.3, high=0.3, typical=0.02),),
    see=_see,
    order=5,
)
