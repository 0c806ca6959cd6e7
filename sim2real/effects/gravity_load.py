"""Gravity load: a weight off the shaft's axis that ``loads`` left out.

The shaft feels ``-torque_Nm sin(q)``, position 0 hanging straight down (a pendulum; any text on
mechanics).
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def pendulum(
    q: wp.float64,
    v: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
) -> wp.float64:
    """Torque of the weight on the shaft in N m."""
    return -p[c] * wp.sin(q)


EFFECT = Effect(
    name="gravity_load",
    site="load",
    term=pendulum,
    parameters=(Parameter("torque_Nm", low=-2.0, high=2.0, typical=0.1),),
)
