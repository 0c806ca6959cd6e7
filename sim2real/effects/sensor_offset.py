"""Sensor offset: the measured angle is wrong by a constant, as when a horn sits one tooth off."""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def offset(
    q: wp.float64,
    v: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
) -> wp.float64:
    """Measured angle in rad."""
    return q + p[c]


EFFECT = Effect(
    name="sensor_offset",
    site="sensor",
    term=offset,
    parameters=(Parameter("offset_rad", low=-0.5, high=0.5, typical=0.02),),
)
