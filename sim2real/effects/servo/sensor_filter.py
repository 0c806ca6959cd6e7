"""Sensor filter: the measured angle is smoothed by a first-order low-pass.

``tau y' + y = q``, exact over a sub-step.

Leaves a lag that grows with frequency like an arctangent. Taken for: latency and a command filter;
only a second sensor tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.elementary import decay


@wp.func
def smooth(
    x: wp.float64,
    q: wp.float64,
    v: wp.float64,
    torque: wp.float64,
    time: wp.float64,
    h: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
    z: wp.array(dtype=wp.float64),
    s: int,
) -> wp.float64:
    """Measured angle in rad."""
    if z[s + 1] == wp.float64(0.0):
        z[s] = x
        z[s + 1] = wp.float64(1.0)
        z[s + 2] = x
    middle = wp.float64(0.5) * (z[s + 2] + x)
    z[s] += (middle - z[s]) * (wp.float64(1.0) - decay(h / p[c]))
    z[s + 2] = x
    return z[s]


EFFECT = Effect(
    name="sensor_filter",
    plain="a filter on the measured angle",
    says="the measured angle is smoothed over {time_constant_s}",
    site="sensor",
    term=smooth,
    parameters=(Parameter("time_constant_s", low=0.0002, high=0.5, typical=0.02),),
    memory=3,
    order=4,
    family="filter",
)
