"""The surface is rougher than thought: friction along it with the square of the speed.

``force = -rho / 2 coefficient area u^2`` along each link of the material.

Taken for: form drag, which grows alike.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], material: str) -> None:
    """Add it to what acts on the robot."""
    robot.rough += p["coefficient"] * robot.made_of(material)


EFFECT = BodyEffect(
    name="surface_friction",
    plain="friction with the ground",
    title="change of the skin friction coefficient of the surface",
    parameters=(Parameter("coefficient", low=-0.1, high=0.3, typical=0.01),),
    act=act,
    by_material=True,
    order=5,
)
