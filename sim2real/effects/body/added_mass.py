"""Change of the added mass of the links, as a share of the displaced water.

Acts on each link's motion normal to its axis and in rotation.

Confused with: drag normal to the links; accelerations distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.resist[:, 2:] += p["ratio"]


EFFECT = BodyEffect(
    name="added_mass",
    plain="an error of the added mass",
    title="change of the transverse added mass, as a share of the displaced water",
    parameters=(Parameter("ratio", low=-0.5, high=2.0, typical=0.2),),
    act=act,
    order=7,
)
