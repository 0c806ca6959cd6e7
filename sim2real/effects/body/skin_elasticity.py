"""The skin over the joints is a spring towards the straight posture.

``torque = -stiffness q`` at each joint.

Confused with: a smaller servo gain; swims with the torque off distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.skin[:, 0] += p["stiffness_Nm_per_rad"]


EFFECT = BodyEffect(
    name="skin_elasticity",
    plain="an elastic skin",
    title="the skin over the joints acts as a spring towards the straight pose",
    parameters=(Parameter("stiffness_Nm_per_rad", low=0.0, high=10.0, typical=0.3),),
    act=act,
    order=0,
)
