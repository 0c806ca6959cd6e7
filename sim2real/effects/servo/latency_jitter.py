"""Latency jitter: each set-point is late by a different time.

Uniform within ``halfwidth_s`` of the latency, drawn anew for each set-point; none overtakes the one
before it.

Leaves noise in proportion to speed. Taken for: sensor noise; regress its square on the speed's.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.warp_types import F, Row

_SEED = wp.constant(31)
"""Of its own, so that no other effect changes what is drawn."""


@wp.func
def scatter(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Time at which a set-point takes effect in s."""
    number = wp.float64(wp.randf(wp.rand_init(_SEED, int(q))))
    return x + p[c] * (wp.float64(2.0) * number - wp.float64(1.0))


EFFECT = Effect(
    name="latency_jitter",
    plain="set-points that arrive unevenly",
    says="set-points arrive up to {halfwidth_s} before or after the mean latency",
    site="arrival",
    term=scatter,
    parameters=(Parameter("halfwidth_s", low=0.0, high=0.1, typical=0.01),),
    component="link",
    order=1,
    fitted=False,
    mimics=("rate_limit", "torque_saturation"),
)
