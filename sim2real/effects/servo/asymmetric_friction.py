"""Asymmetric friction: Coulomb friction that differs between the two directions.

``bound = torque (1 + asymmetry sgn v)``; ``asymmetry`` is half the relative difference. Caused by
worn screws and preloaded gears; on the EMPS drive it is the best-known missing term. Residual: a
square wave with an offset. Confused with: Coulomb friction together with a sensor offset or a
gravity load.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def bound(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x + p[c] * (wp.float64(1.0) + p[c + 1] * wp.sign(v))


EFFECT = Effect(
    plain="friction that differs by direction",
    says="Coulomb friction averages {torque_Nm} and is {asymmetry} larger than that in the "
    "{asymmetry:positive|negative} direction",
    site="friction",
    term=bound,
    parameters=(
        Parameter("torque_Nm", low=0.0, high=1.0, typical=0.05),
        Parameter("asymmetry", low=-1.0, high=1.0, typical=0.3, starts=(-2.0, 2.0)),
    ),
    family="dry friction",
)
