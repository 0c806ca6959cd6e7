"""Sensor gain: the measured angle has a relative error ``gain``.

``angle = (1 + gain) q``. Residual: an error proportional to the angle. Confused with: an elastic
skin; another servo gain or supply voltage distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def scale(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x * (wp.float64(1.0) + p[c])


EFFECT = Effect(
    plain="a gain error of the angle sensor",
    says="the angle sensor reads {gain} too {gain:large|small}",
    site="sensor",
    term=scale,
    parameters=(Parameter("gain", low=-0.5, high=0.5, typical=0.02),),
    order=2,
    steady=True,
)
