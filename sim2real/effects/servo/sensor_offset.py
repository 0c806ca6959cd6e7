"""Sensor offset: the measured angle has a constant error, as when a horn is mounted one tooth off.

Residual: a constant. Confused with: a gravity load about a level position.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def shift(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x + p[c]


EFFECT = Effect(
    plain="an offset of the angle sensor",
    says="the angle sensor reads {offset_rad} too {offset_rad:high|low}",
    site="sensor",
    term=shift,
    parameters=(Parameter("offset_rad", low=-0.5, high=0.5, typical=0.02),),
    order=3,
    steady=True,
)
