"""Stribeck friction: friction that is largest at breakaway and decreases with speed.

``bound = torque + (breakaway - torque) exp(-(v / velocity)^2)``. Fits keep ``breakaway`` at or
above ``torque``: friction that increases with speed is damping, not the Stribeck effect. Source:
Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138. Residual: an additional
error just after reversals, and stick-slip at low speed. Confused with: Coulomb friction, which it
contains; only motion below ``velocity_rad_s`` distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay


@wp.func
def bound(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    bound = p[c]
    if p[c + 2] > wp.float64(0.0):
        slow = v / p[c + 2]
        bound += (p[c + 1] - p[c]) * decay(slow * slow)
    return x + bound


EFFECT = Effect(
    plain="Stribeck friction",
    says=lambda p: (
        "friction of {breakaway_Nm} at standstill falls to {torque_Nm} above about {velocity_rad_s}"
        if p["breakaway_Nm"] > p["torque_Nm"]
        else "Coulomb friction of {torque_Nm} acts on the shaft"
    ),
    site="friction",
    term=bound,
    parameters=(
        Parameter("torque_Nm", low=0.0, high=1.0, typical=0.05),
        Parameter("breakaway_Nm", low=0.0, high=2.0, typical=0.1),
        Parameter("velocity_rad_s", low=0.003, high=5.0, typical=0.3),
    ),
    family="dry friction",
    ascending=("torque_Nm", "breakaway_Nm"),
)
