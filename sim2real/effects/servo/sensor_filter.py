"""Sensor filter: the measured angle is smoothed by a first-order low-pass filter.

``tau y' + y = q``, exact over a sub-step. Residual: a phase lag that grows with frequency as an
arctangent. Confused with: latency and a command filter; only a second sensor distinguishes them.
Both filters together are told from one.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay


@wp.func
def smooth(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if z[s + 1] == wp.float64(0.0):
        z[s] = x
        z[s + 1] = wp.float64(1.0)
        z[s + 2] = x
    middle = wp.float64(0.5) * (z[s + 2] + x)
    z[s] += (middle - z[s]) * (wp.float64(1.0) - decay(h / p[c]))
    z[s + 2] = x
    return z[s]


EFFECT = Effect(
    plain="a filter on the measured angle",
    says="the measured angle is low-pass filtered with a time constant of {time_constant_s}",
    site="sensor",
    term=smooth,
    parameters=(Parameter("time_constant_s", low=0.0002, high=0.5, typical=0.02),),
    memory=3,
    order=4,
    family="filter",
)
