"""Coulomb friction: friction of constant magnitude, independent of speed.

While the shaft turns, the torque ``torque_Nm`` acts against the motion; at rest it balances any
smaller torque. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138.
Residual: a square wave in the sign of the speed. Confused with: dead band, backlash, presliding
friction; a slow triangle distinguishes them, as the width of the hysteresis loop does not depend on
its amplitude.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def bound(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x + p[c]


EFFECT = Effect(
    plain="Coulomb friction",
    says="Coulomb friction of {torque_Nm} acts on the shaft",
    site="friction",
    term=bound,
    parameters=(Parameter("torque_Nm", low=0.0, high=1.0, typical=0.05),),
    family="dry friction",
)
