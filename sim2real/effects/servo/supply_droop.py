"""Supply droop: the battery discharges, and the available torque decreases with its voltage.

The commanded torque scales with the voltage, the damping by back-EMF does not: ``torque = kp error
(1 - loss_per_min * minutes) - kd v`` (the circuit of a DC motor behind a bridge; any text on
motors). Residual: a gain that decreases linearly with time, equally on all joints. Confused with:
thermal derating, clock drift; a charged battery distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def droop(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    remaining = wp.max(wp.float64(1.0) - p[c] * time / wp.float64(60.0), wp.float64(0.0))
    return (x + p[1] * v) * remaining - p[1] * v


EFFECT = Effect(
    plain="a discharging battery",
    says="the supply voltage, and the motor torque with it, {loss_per_min:falls|rises} by "
    "{loss_per_min}",
    site="motor",
    term=droop,
    parameters=(Parameter("loss_per_min", low=-0.5, high=0.5, typical=0.1),),
    component="supply",
    order=1,
)
