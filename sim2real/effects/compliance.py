"""Compliance: the gear train twists under the torque that it carries.

The sensor sees ``q - compliance * torque``: the twist follows the torque at once, which holds well
below the resonance of load and spring.

Leaves error in proportion to torque. Taken for: kp, latency; known added inertia tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def twist(
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
    return x - p[c] * torque


EFFECT = Effect(
    name="compliance",
    site="sensor",
    term=twist,
    parameters=(Parameter("compliance_rad_per_Nm", low=0.0, high=0.5, typical=0.02),),
)
