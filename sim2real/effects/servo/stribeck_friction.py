"""Stribeck friction: dry friction that is larger at breakaway and falls with speed.

``bound = torque + (breakaway - torque) exp(-(v / velocity)^2)``.
Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994) 1083-1138.

Leaves extra error just after reversals and stick-slip at low speed. Taken for: Coulomb friction,
which it contains; only motion below ``velocity_rad_s`` tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.elementary import decay


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
    bound = p[c]
    if p[c + 2] > wp.float64(0.0):
        slow = v / p[c + 2]
        bound += (p[c + 1] - p[c]) * decay(slow * slow)
    return x + bound


EFFECT = Effect(
    name="stribeck_friction",
    plain="friction that is larger near standstill",
    says="friction of {breakaway_Nm} falls to {torque_Nm} above about {velocity_rad_s}",
    site="friction",
    term=bound,
    parameters=(
        Parameter("torque_Nm", low=0.0, high=1.0, typical=0.05),
        Parameter("breakaway_Nm", low=0.0, high=2.0, typical=0.1),
        Parameter("velocity_rad_s", low=0.003, high=5.0, typical=0.3),
    ),
    family="dry friction",
)
