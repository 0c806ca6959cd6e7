"""Load-dependent friction: friction proportional to the torque transmitted by the gears.

``bound = ratio |torque|``, as teeth and bearings are pressed together. Source: Duclusaud, Passault,
Padois, Ly, Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA 2025.

Residual: an error proportional to load that differs between driving and back-driving. Confused
with: a smaller kp, which absorbs nearly all of it; another load or gain distinguishes them.
"""

import warp as wp

from sim2real.effects.effect import Effect, F, Parameter, Row


@wp.func
def bound(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Largest friction torque in N m."""
    return x + p[c] * wp.abs(torque)


EFFECT = Effect(
    plain="load-dependent friction",
    says="gear friction opposes the motion with {ratio} of the transmitted torque",
    site="friction",
    term=bound,
    parameters=(Parameter("ratio", low=0.0, high=0.9, typical=0.2),),
)
