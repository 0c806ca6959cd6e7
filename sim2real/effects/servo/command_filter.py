"""Command filter: the servo smooths its set-point by a first-order low-pass.

``tau y' + y = u``, exact over a sub-step.

Leaves a smooth onset. Taken for: latency, which absorbs most of it, and a sensor filter, which
looks the same from one sensor.
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
    """Set-point in force in rad."""
    if z[s + 1] == wp.float64(0.0):
        z[s] = x
        z[s + 1] = wp.float64(1.0)
    gap = z[s] - x
    left = decay(h / p[c])
    z[s] = x + gap * left
    return x + gap * (wp.float64(1.0) - left) * p[c] / h  # its mean over the sub-step


EFFECT = Effect(
    name="command_filter",
    plain="a filter on the set-point",
    says="the servo smooths its set-point over {time_constant_s}",
    site="command",
    term=smooth,
    parameters=(Parameter("time_constant_s", low=0.0003, high=0.5, typical=0.03),),
    memory=2,
    order=2,
    family="filter",
)
