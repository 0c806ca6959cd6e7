"""Torque saturation: the motor gives less than its data sheet says, ``limit_Nm`` either way.

``torque = clip(torque + free, -limit, limit) - free``: a limit of firmware or current, at any
speed. ``free = free_damping kd v`` is the share of the damping that acts beyond it: none where the
current is limited, all but what the firmware damps where the drive is, as in MuJoCo's actuators.
The line of torque over speed, which no motor exceeds, is part of the servo's law (``servo.motor``);
this effect is a limit below it.

Leaves an acceleration that stays level after large steps. Taken for: rate limit, voltage sag; added
inertia tells, as it makes this one worse and not the rate limit.
"""

import warp as wp

from sim2real.effects.effect import LIMITS, Effect, Parameter
from sim2real.effects.warp_types import F, Row


@wp.func
def clip(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Torque that the motor makes in N m."""
    beyond = p[c + 1] * p[1] * v
    return wp.clamp(x + beyond, -p[c], p[c]) - beyond


EFFECT = Effect(
    name="torque_saturation",
    plain="a torque limit below the data sheet's",
    says="the motor torque is limited to {limit_Nm}",
    site="motor",
    term=clip,
    parameters=(
        Parameter("limit_Nm", low=0.005, high=20.0, typical=0.5, starts=LIMITS),
        Parameter("free_damping", low=0.0, high=1.0, typical=1.0, starts=(0.05, 0.95)),
    ),
    order=2,
)
