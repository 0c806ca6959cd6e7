"""Voltage sag: the supply voltage drops under load, and the torque with it.

The commanded torque scales with the voltage, the damping by back-EMF does not: ``torque = kp error
(1 - loss |torque| / full) - kd v``, where the full load is the torque commanded at an error of half
a radian (the circuit of a DC motor behind a bridge; any text on motors). The loss is at most a
half: controllers reset before, that of an XL330 below 3.7 of 5 V (its manual). Residual: a gain
that decreases with load. Confused with: torque saturation, load friction; moving another joint on
the same supply distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def sag(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    full = wp.max(wp.float64(0.5) * p[0], wp.float64(1e-12))
    remaining = wp.float64(1.0) - p[c] * wp.min(wp.abs(x) / full, wp.float64(1.0))
    return (x + p[1] * v) * remaining - p[1] * v


EFFECT = Effect(
    plain="a supply voltage that sags under load",
    says="the supply voltage sags and costs {loss_at_full_load} of the motor torque at full load",
    site="motor",
    term=sag,
    parameters=(Parameter("loss_at_full_load", low=0.0, high=0.5, typical=0.2),),
    component="supply",
    order=1,
    mimics=("torque_saturation",),
)
