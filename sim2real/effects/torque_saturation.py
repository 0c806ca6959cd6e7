"""Torque saturation: the motor cannot give more than ``limit_Nm`` either way.

``torque = clip(torque, -limit, limit)``, the flat part of a servo's torque-speed curve. A limit of
0 means that there is none.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def clip(
    torque: wp.float64,
    q: wp.float64,
    v: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
) -> wp.float64:
    """Torque that the motor makes in N m."""
    return wp.clamp(torque, -p[c], p[c])


EFFECT = Effect(
    name="torque_saturation",
    site="motor",
    term=clip,
    parameters=(Parameter("limit_Nm", low=0.0, high=20.0, typical=1.2),),
)
