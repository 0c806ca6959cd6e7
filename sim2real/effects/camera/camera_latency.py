"""The poses of the camera are delayed.

``pose(t) = true pose(t - latency)``.

Confused with: the servos' latency, where no angles are recorded.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import Array, CameraEffect, late
from sim2real.inference.parameters import Parameter


def see(t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as measured by the camera."""
    return late(t, pose, p["latency_s"])


EFFECT = CameraEffect(
    name="camera_latency",
    plain="latency of the camera",
    title="delay of the camera's poses",
    parameters=(Parameter("latency_s", low=-0.05, high=0.5, typical=0.05),),
    see=see,
    order=1,
)
