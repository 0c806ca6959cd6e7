"""The skin couples neighbouring joints elastically.

``torque = stiffness (q_before + q_after - 2 q)`` at each joint. Confused with: an elastic skin;
moving one joint alone distinguishes them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="a skin that couples neighbouring joints",
    title="the skin acts as a spring between neighbouring joints",
    parameters=(Parameter("stiffness_Nm_per_rad", low=0.0, high=5.0, typical=0.2),),
    adds=lambda _robot, p, _material: {"coupling": p["stiffness_Nm_per_rad"]},
    order=3,
)
