"""The skin couples neighbouring joints elastically.

``torque = stiffness (q_before + q_after - 2 q)`` at each joint.

Confused with: an elastic skin; moving one joint alone distinguishes them.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.coupling += p["stiffness_Nm_per_rad"]


EFFECT = BodyEffect(
    name="skin_coupling",
    plain="a skin that couples neighbouring joints",
    title="the skin acts as a spring between neighbouring joints",
    parameters=(Parameter("stiffness_Nm_per_rad", low=0.0, high=5.0, typical=0.2),),
    act=act,
    order=3,
)
