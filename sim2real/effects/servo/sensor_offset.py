"""Sensor offset: the measured angle is wrong by a constant, as when a horn sits one tooth off.

Leaves a constant. Taken for: a gravity load about a level position.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.warp_types import F, Row


@wp.func
def shift(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Measured angle in rad."""
    return x + p[c]


EFFECT = Effect(
    name="sensor_offset",
    plain="an angle sensor whose zero is off",
    says=lambda p: (
        "the angle sensor reads {offset_rad} too " + ("high" if p["offset_rad"] > 0 else "low")
    ),
    site="sensor",
    term=shift,
    parameters=(Parameter("offset_rad", low=-0.5, high=0.5, typical=0.02),),
    order=3,
    steady=True,
)
