"""The camera's poses are late.

``pose(t) = true pose(t - latency)``.

Taken for: the servos' latency, where no angles are recorded.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import Array, CameraEffect, late
from sim2real.inference.parameters import Parameter


def see(t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as the camera gives them."""
    return late(t, pose, p["latency_s"])


EFFECT = CameraEffect(
    name="camera_latency",
    plain="a camera that sees late",
    title="delay of the camera's poses",
    parameters=(Parameter("latency_s", low=-0.05, high=0.5, typical=0.05),),
    see=see,
    order=1,
)
