"""The joints' zero is off by an angle, to the same side.

``q = 0`` is off by ``offset_rad`` at every joint.

Taken for: a current across; swims both ways tell.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, BodyParameter, Forces


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.trim += p["offset_rad"]


EFFECT = BodyEffect(
    name="trim_asymmetry",
    plain="a straight posture that is off to one side",
    title="the joints' zero is off by an angle, to the same side",
    parameters=(BodyParameter("offset_rad", "rad", 0.03, -0.5, 0.5),),
    act=act,
    order=12,
)
