"""Gravity load: a weight off the shaft's axis that ``loads`` left out.

The shaft feels ``-torque_Nm sin(q)``, position 0 hanging straight down (a pendulum; any text on
mechanics).

Leaves a static error that grows with the sine of the angle. Taken for: a larger kp with a sensor
gain; another gain or supply tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.elementary import sine


@wp.func
def pendulum(
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
    """Torque on the shaft in N m."""
    return x - p[c] * sine(q)


EFFECT = Effect(
    name="gravity_load",
    plain="a weight that the loads leave out",
    says="a weight that the loads leave out pulls with {torque_Nm} when level",
    site="load",
    term=pendulum,
    parameters=(Parameter("torque_Nm", low=-2.0, high=2.0, typical=0.1),),
    either_sign=True,
    load="gravity_Nm",
)
