"""Sensor gain: measured angles are too large or too small by a factor ``gain`` off 1.

``angle = (1 + gain) q``.

Leaves error in proportion to the angle. Taken for: elastic skin; another servo gain or supply
tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.warp_types import F, Row


@wp.func
def scale(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Measured angle in rad."""
    return x * (wp.float64(1.0) + p[c])


EFFECT = Effect(
    name="sensor_gain",
    plain="an angle sensor whose scale is off",
    says=lambda p: "the angle sensor reads {gain} too " + ("large" if p["gain"] > 0 else "small"),
    site="sensor",
    term=scale,
    parameters=(Parameter("gain", low=-0.5, high=0.5, typical=0.02),),
    order=2,
    steady=True,
)
