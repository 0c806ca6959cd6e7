"""Torque asymmetry: the motor has more torque in one direction than in the other.

``torque *= 1 + asymmetry / 2 sgn(torque)``; ``asymmetry`` is the relative difference between the
two directions. Residual: an error that differs between rising and falling steps. Confused with:
asymmetric friction.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def favour(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x * (wp.float64(1.0) + wp.float64(0.5) * p[c] * wp.sign(x))


EFFECT = Effect(
    plain="a motor torque that differs by direction",
    says="the motor torque is {asymmetry} larger in the "
    "{asymmetry:positive direction than in the negative|negative direction than in the positive}",
    site="motor",
    term=favour,
    parameters=(Parameter("asymmetry", low=-1.0, high=1.0, typical=0.2),),
    order=1,
)
