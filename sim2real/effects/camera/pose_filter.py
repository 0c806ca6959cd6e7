"""The poses are smoothed by a first-order low-pass filter.

``time_constant p' + p = true p``. Confused with: latency, which has the same effect at low
frequencies.
"""

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.body_effect import CameraEffect, Parameter, Values


def _see(t: Array, pose: Array, p: Values) -> Array:
    from scipy.signal import lfilter  # takes half a second to load; servos need the catalogue too

    if p["time_constant_s"] <= 0:
        return pose
    kept = float(np.exp(-float(np.median(np.diff(t))) / p["time_constant_s"]))
    smooth = lfilter([1 - kept], [1, -kept], pose - pose[0], axis=0)
    return np.asarray(pose[0] + smooth)


EFFECT = CameraEffect(
    plain="a filter on the camera's poses",
    title="the camera's poses pass a first-order low-pass filter",
    parameters=(Parameter("time_constant_s", low=0.0, high=1.0, typical=0.05),),
    see=_see,
    order=3,
)
