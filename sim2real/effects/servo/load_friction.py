"""Load-dependent friction: dry friction that grows with the torque through the gears.

``bound = ratio |torque|``, as teeth and bearings press harder. Source: Duclusaud, Passault, Padois,
Ly, Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA 2025.

Leaves error in proportion to load; driving and back-driving differ. Taken for: a smaller kp, which
absorbs nearly all of it; another load or gain tells.
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
    return x + p[c] * wp.abs(torque)


EFFECT = Effect(
    name="load_friction",
    plain="friction that grows with load",
    says="gear friction opposes the motion with {ratio} of the transmitted torque",
    site="friction",
    term=bound,
    parameters=(Parameter("ratio", low=0.0, high=0.9, typical=0.2),),
)
