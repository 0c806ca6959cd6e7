"""The marker is displaced from the head's centre of mass, forward and to the left.

``position + R(heading) (x, y)``. Confused with: an offset of the centre of mass.
"""

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.body_effect import CameraEffect, Parameter, Values


def _see(_t: Array, pose: Array, p: Values) -> Array:
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    ahead, left = p["x_m"], p["y_m"]
    moved = [ahead * c - left * s, ahead * s + left * c, np.zeros_like(c)]
    return pose + np.stack(moved, axis=1)


EFFECT = CameraEffect(
    plain="an offset of the marker",
    title="offset of the marker from the head's centre of mass, forwards and to the left",
    parameters=(
        Parameter("x_m", low=-0.3, high=0.3, typical=0.02),
        Parameter("y_m", low=-0.1, high=0.1, typical=0.02),
    ),
    see=_see,
    order=0,
)
