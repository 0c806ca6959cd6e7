"""Torque saturation: the torque is limited to ``limit_Nm``, below the data sheet's.

``torque = clip(torque + free, -limit, limit) - free``: a limit of firmware or current, at any
speed. ``free = free_damping kd v`` is the part of the damping that acts beyond the limit: none
where the current is limited; all but the firmware's damping where the drive is limited, as in
MuJoCo's actuators. The torque-speed line of the motor is part of the servo's law (``servo.motor``);
this effect is a limit below it. Residual: a constant acceleration after large steps. Confused with:
rate limit, voltage sag; additional inertia distinguishes them, as it increases this residual and
not that of a rate limit.
"""

from sim2real.effects.effect import LIMITS, Effect, F, Parameter, Row, wp


@wp.func
def clip(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    beyond = p[c + 1] * p[1] * v
    return wp.clamp(x + beyond, -p[c], p[c]) - beyond


EFFECT = Effect(
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
