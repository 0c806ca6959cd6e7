"""The marker sits off the head's centre of mass, forwards and to the left.

``position + R(heading) (x, y)``.

Taken for: a centre of mass that is off.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import Array, BodyParameter, CameraEffect


def see(_t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as the camera gives them."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    ahead, left = p["x_m"], p["y_m"]
    moved = [ahead * c - left * s, ahead * s + left * c, np.zeros_like(c)]
    return pose + np.stack(moved, axis=1)


EFFECT = CameraEffect(
    name="marker_offset",
    plain="a marker that sits elsewhere",
    title="the marker sits off the head's centre of mass, forwards and to the left",
    parameters=(
        BodyParameter("x_m", "m", 0.02, -0.3, 0.3),
        BodyParameter("y_m", "m", 0.02, -0.1, 0.1),
    ),
    see=see,
    order=0,
)
