"""Some frames are lost and the previous pose is repeated.

On average the poses are then late by p / (1 - p) frames; this mean delay is applied, so that the
result is a smooth function of p. Confused with: latency.
"""

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.body_effect import CameraEffect, Parameter, Values, late


def _see(t: Array, pose: Array, p: Values) -> Array:
    lost = min(p["probability"], 0.9)
    return late(t, pose, float(np.median(np.diff(t))) * lost / (1 - lost))


EFFECT = CameraEffect(
    plain="lost camera frames",
    title="frames are lost and the last pose is repeated",
    parameters=(Parameter("probability", low=0.0, high=0.4, typical=0.05),),
    see=_see,
    order=2,
)
