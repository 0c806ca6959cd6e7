"""Dead band: the controller ignores errors up to ``halfwidth_rad``.

``error = sgn(error) max(|error| - halfwidth, 0)``.

Residual: a static offset within the band, and small sines with flat tops. Confused with: Coulomb
friction, backlash; small steps under load distinguish them, as the band does not depend on the
direction of the load.
"""

import warp as wp

from sim2real.effects.effect import Effect, F, Parameter, Row


@wp.func
def ignore(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Error that the controller sees in rad."""
    return x - wp.clamp(x, -p[c], p[c])


EFFECT = Effect(
    plain="a dead band of the controller",
    says="the controller ignores position errors below {halfwidth_rad}",
    site="error",
    term=ignore,
    parameters=(Parameter("halfwidth_rad", low=0.0, high=0.1, typical=0.01),),
)
