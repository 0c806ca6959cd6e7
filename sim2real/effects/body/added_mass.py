"""More water goes along with the body sideways; a share of what it displaces.

The share of the displaced water that goes along with a link across it and as it turns.

Taken for: drag across the links; starts tell.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.resist[:, 2:] += p["ratio"]


EFFECT = BodyEffect(
    name="added_mass",
    plain="water that is carried along",
    title="change of the transverse added mass, as a share of the displaced water",
    parameters=(Parameter("ratio", low=-0.5, high=2.0, typical=0.2),),
    act=act,
    order=7,
)
