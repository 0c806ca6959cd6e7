"""Sensor offset: the measured angle is wrong by a constant, as when a horn sits one tooth off.

Leaves a constant. Taken for: a gravity load about a level position.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def shift(
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
