"""Dead band: the controller ignores errors up to ``halfwidth_rad``.

``error = sgn(error) max(|error| - halfwidth, 0)``.

Leaves a static offset within the band and flat-topped small sines. Taken for: Coulomb friction,
backlash; hold and nudge tells, as the band does not care about the direction of the load.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def ignore(
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
    """Error that the controller sees in rad."""
    return x - wp.clamp(x, -p[c], p[c])


EFFECT = Effect(
    name="deadband",
    plain="a dead band of the controller",
    says="the controller ignores position errors below {halfwidth_rad}",
    site="error",
    term=ignore,
    parameters=(Parameter("halfwidth_rad", low=0.0, high=0.1, typical=0.01),),
)
