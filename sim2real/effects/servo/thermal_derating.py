"""Thermal derating: the motor loses torque as it heats up.

A temperature z follows the square of the torque over ``warm_torque_Nm``, with a time constant of 30
s; ``torque *= 1 - loss (1 - exp(-z))``. A lumped approximation of the rise of the winding
resistance and the decrease of the magnets' field. Where ``warm_torque_Nm`` is not known, it is the
torque that PD control commands at an error of 0.1 rad. Residual: a gain that decreases over minutes
of work and recovers at rest. Confused with: supply droop; a pause distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay


@wp.func
def weaken(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    warm = p[c + 1]
    if warm == wp.float64(0.0):
        warm = wp.max(wp.float64(0.1) * p[0], wp.float64(1e-12))
    relative = torque / warm
    z[s] += h / wp.float64(30.0) * (relative * relative - z[s])
    return x * (wp.float64(1.0) - p[c] * (wp.float64(1.0) - decay(z[s])))


EFFECT = Effect(
    plain="thermal derating of the motor",
    says="the motor loses up to {loss} of its torque as it heats up",
    site="motor",
    term=weaken,
    parameters=(
        Parameter("loss", low=0.0, high=0.9, typical=0.4),
        Parameter("warm_torque_Nm", low=0.02, high=2.0, typical=0.2),
    ),
    memory=1,
    order=1,
)
