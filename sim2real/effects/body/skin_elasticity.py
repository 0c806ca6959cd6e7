"""The skin over the joints is a spring towards the straight posture.

``torque = -stiffness q`` at each joint. Confused with: a smaller servo gain; swims with the torque
off distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an elastic skin",
    title="the skin over the joints acts as a spring towards the straight pose",
    parameters=(Parameter("stiffness_Nm_per_rad", low=0.0, high=10.0, typical=0.3),),
    adds=lambda _robot, p, _material: {"skin": (p["stiffness_Nm_per_rad"], 0, 0, 0)},
    order=0,
)
