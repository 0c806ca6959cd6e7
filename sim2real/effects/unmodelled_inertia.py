"""Unmodelled inertia: rotor, gears or arm that the stated load left out.

A rotor behind gears of ratio n adds n squared times its own inertia to the shaft, often as much as
the load itself (any text on drives).
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def rotor(
    p: wp.array(dtype=wp.float64),
    c: int,
) -> wp.float64:
    """Inertia added to the shaft in kg m2."""
    return p[c]


EFFECT = Effect(
    name="unmodelled_inertia",
    site="inertia",
    term=rotor,
    parameters=(Parameter("inertia_kgm2", low=-0.9, high=0.1, typical=0.001),),
)
