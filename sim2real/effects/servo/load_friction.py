"""Load-dependent friction: dry friction that grows with the torque through the gears.

``bound = ratio |torque|``, as teeth and bearings press harder. Source: Duclusaud, Passault, Padois,
Ly, Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA 2025.

Leaves error in proportion to load; driving and back-driving differ. Taken for: a smaller kp, which
absorbs nearly all of it; another load or gain tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter
from sim2real.effects.warp_types import F, Row


@wp.func
def bound(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
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
