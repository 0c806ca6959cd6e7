"""Presliding friction: Coulomb friction that acts as a spring before it slips.

A bristle of deflection z, ``z' = v (1 - stiffness z sgn(v) / torque)``, exerts ``-stiffness z -
damping z'``: Dahl's model with exponent 1, integrated exactly over a sub-step, and the damping of
the LuGre model (Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, European Journal of Control 4
(1998) 176-195), ``2 damping_ratio`` times the root of stiffness and inertia. Residual: elastic
loops within a degree of each reversal. Confused with: Coulomb friction, compliance; small sines
distinguish them, by their minor loops.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay


@wp.func
def bristle(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if p[c] == wp.float64(0.0):
        return x
    before = z[s]
    slip = wp.sign(v) * p[c] / p[c + 1]
    z[s] = slip + (before - slip) * decay(wp.abs(v) * h * p[c + 1] / p[c])
    damping = wp.float64(2.0) * p[c + 2] * wp.sqrt(p[c + 1] * p[3])
    spring = wp.float64(0.5) * p[c + 1] * (before + z[s])  # its mean over the sub-step
    return x - spring - wp.min(damping / h, p[3] / (h * h)) * (z[s] - before)


EFFECT = Effect(
    plain="presliding friction",
    says="Coulomb friction of {torque_Nm} acts as a spring of {stiffness_Nm_per_rad} "
    "before it slips",
    site="load",
    term=bristle,
    parameters=(
        Parameter("torque_Nm", low=0.0, high=1.0, typical=0.05),
        Parameter("stiffness_Nm_per_rad", low=0.1, high=200.0, typical=10.0),
        Parameter("damping_ratio", low=0.0, high=2.0, typical=0.5, starts=(1.0,)),
    ),
    memory=1,
    family="dry friction",
)
