"""Gravity load: an eccentric weight that is missing from ``loads``.

A pendulum torque ``-torque_Nm sin(q)`` on the shaft, hanging straight down at position 0 (any text
on mechanics). Residual: a static error that grows with the sine of the angle. Confused with: a
larger kp together with a sensor gain; another gain or supply voltage distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import sine


@wp.func
def pendulum(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x - p[c] * sine(q)


EFFECT = Effect(
    plain="a weight missing from the stated load",
    says="a gravity torque of up to {torque_Nm}, missing from the stated load, pulls the shaft "
    "{torque_Nm:towards|away from} 0°",
    site="load",
    term=pendulum,
    parameters=(Parameter("torque_Nm", low=-2.0, high=2.0, typical=0.1),),
    either_sign=True,
    load="gravity_Nm",
)
