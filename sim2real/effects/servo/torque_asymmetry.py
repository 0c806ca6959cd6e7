"""Torque asymmetry: the motor pulls harder one way than the other.

``torque *= 1 + asymmetry / 2 sgn(torque)``; ``asymmetry`` is the relative difference between the
two directions.

Leaves error that differs between rising and falling steps. Taken for: asymmetric friction.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def favour(
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
    """Torque that the motor makes in N m."""
    return x * (wp.float64(1.0) + wp.float64(0.5) * p[c] * wp.sign(x))


EFFECT = Effect(
    name="torque_asymmetry",
    plain="a motor that pulls harder one way",
    says=lambda p: (
        "the motor torque is {asymmetry} larger in the "
        + (
            "positive direction than in the negative"
            if p["asymmetry"] > 0
            else "negative direction than in the positive"
        )
    ),
    site="motor",
    term=favour,
    parameters=(Parameter("asymmetry", low=-1.0, high=1.0, typical=0.2),),
    order=1,
)
