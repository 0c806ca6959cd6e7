"""Gravity load: a weight off the shaft's axis that ``loads`` left out.

The shaft feels ``-torque_Nm sin(q)``, position 0 hanging straight down (a pendulum; any text on
mechanics).

Leaves a static error that grows with the sine of the angle. Taken for: a larger kp with a sensor
gain; another gain or supply tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


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
    return x - p[c] * wp.sin(q)


EFFECT = Effect(
    name="gravity_load",
    plain="a weight that the loads leave out",
    says=lambda p: (
        "a gravity torque of up to {torque_Nm}, missing from the stated load, pulls the shaft "
        + ("towards 0°" if p["torque_Nm"] > 0 else "away from 0°")
    ),
    site="load",
    term=pendulum,
    parameters=(Parameter("torque_Nm", low=-2.0, high=2.0, typical=0.1),),
    either_sign=True,
    load="gravity_Nm",
)
