"""Command filter: the servo smooths its set-point by a first-order low-pass filter.

``tau y' + y = u``, exact over a sub-step. Residual: a smooth onset of motion. Confused with:
latency, which absorbs most of it, and a sensor filter, which has the same effect on a single
sensor. Both together are told from one, but on a servo without friction or limits not which has
which time constant.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay


@wp.func
def smooth(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if z[s + 1] == wp.float64(0.0):
        z[s] = x
        z[s + 1] = wp.float64(1.0)
    gap = z[s] - x
    remaining = decay(h / p[c])
    z[s] = x + gap * remaining
    return x + gap * (wp.float64(1.0) - remaining) * p[c] / h  # its mean over the sub-step


EFFECT = Effect(
    plain="a filter on the set-point",
    says="the servo low-pass filters its set-point with a time constant of {time_constant_s}",
    site="command",
    term=smooth,
    parameters=(Parameter("time_constant_s", low=0.0003, high=0.5, typical=0.03),),
    memory=2,
    order=2,
    family="filter",
)
