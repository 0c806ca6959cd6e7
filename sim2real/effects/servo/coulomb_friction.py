"""Coulomb friction: dry friction of one size, whatever the speed.

While the shaft turns, the torque ``torque_Nm`` acts against the motion; at rest it holds any
smaller torque. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138.

Leaves a square wave in the sign of the speed. Taken for: dead band, backlash, presliding friction;
a slow triangle tells, as the width of the force-position loop does not depend on its amplitude.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def bound(
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
    """Largest friction torque in N m."""
    return x + p[c]


EFFECT = Effect(
    name="coulomb_friction",
    plain="dry friction",
    says="Coulomb friction of {torque_Nm} acts on the shaft",
    site="friction",
    term=bound,
    parameters=(Parameter("torque_Nm", low=0.0, high=1.0, typical=0.05),),
    family="dry friction",
)
