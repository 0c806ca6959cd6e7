"""The skin over the joints damps their motion.

``torque = -damping q'`` at each joint.

Confused with: the servo's damping; bench recordings with and without the skin distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.skin[:, 1] += p["damping_Nms_per_rad"]


EFFECT = BodyEffect(
    name="skin_damping",
    plain="damping by the skin",
    title="the skin over the joints acts as a damper",
    parameters=(Parameter("damping_Nms_per_rad", low=0.0, high=2.0, typical=0.03),),
    act=act,
    order=1,
)
