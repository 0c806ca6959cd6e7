"""A uniform current in the pool.

The water's velocity in the world frame. Confused with: a position error of the camera; swims in
both directions distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="a current in the pool",
    title="uniform current in the pool",
    parameters=(
        Parameter("u_m_s", low=-0.5, high=0.5, typical=0.02),
        Parameter("v_m_s", low=-0.5, high=0.5, typical=0.02),
    ),
    adds=lambda _robot, p, _material: {"current": (p["u_m_s"], p["v_m_s"])},
    order=8,
)
