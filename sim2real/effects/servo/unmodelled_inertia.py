"""Unmodelled inertia: rotor, gears or arm that are missing from the stated load.

A rotor behind gears of ratio n adds n squared times its inertia to the shaft, often as much as
the load itself (any text on drives).

Residual: an error proportional to acceleration. Confused with: latency, tens of milliseconds of it;
a pendulum distinguishes them, as its weight is known.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.warp_types import F, Row


@wp.func
def rotor(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Inertia on the shaft in kg m2."""
    return x + p[c]


EFFECT = Effect(
    name="unmodelled_inertia",
    plain="inertia missing from the stated load",
    says=lambda p: (
        "the stated load inertia is {inertia_kgm2} too "
        + ("small, as when it omits the rotor and the gears" if p["inertia_kgm2"] > 0 else "large")
    ),
    site="inertia",
    term=rotor,
    parameters=(Parameter("inertia_kgm2", low=-0.0018, high=0.04, typical=0.001),),
    either_sign=True,
    load="inertia_kgm2",
)
