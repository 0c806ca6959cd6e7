"""Some frames are lost and the previous pose is repeated.

On average the poses are then late by p / (1 - p) frames; this mean delay is applied, so that the
result is a smooth function of p.

Confused with: latency.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import Array, CameraEffect, late
from sim2real.inference.parameters import Parameter


def see(t: Array, pose: Array, p: Mapping[str, float]) -> Array:
    """Poses as measured by the camera."""
    lost = min(p["probability"], 0.9)
    return late(t, pose, float(np.median(np.diff(t))) * lost / (1 - lost))


EFFECT = CameraEffect(
    name="dropped_frames",
    plain="lost camera frames",
    title="frames are lost and the last pose is repeated",
    parameters=(Parameter("probability", low=0.0, high=0.4, typical=0.05),),
    see=see,
    order=2,
)
