"""The joints' zero is off by an angle, to the same side.

``q = 0`` is off by ``offset_rad`` at every joint.

Taken for: a current across; swims both ways tell.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.trim += p["offset_rad"]


EFFECT = BodyEffect(
    name="trim_asymmetry",
    plain="a straight posture that is off to one side",
    title="offset of all joint zeros by the same angle",
    parameters=(Parameter("offset_rad", low=-0.5, high=0.5, typical=0.03),),
    act=act,
    order=12,
)
