"""Change of the skin friction of a material, which is quadratic in speed.

``force = -rho / 2 coefficient area u^2`` along each link of the material.

Confused with: form drag, which grows with speed in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.rough += p["coefficient"] * robot.made_of(material)


EFFECT = BodyEffect(
    name="surface_friction",
    plain="an error of the skin friction",
    title="change of the skin friction coefficient of the surface",
    parameters=(Parameter("coefficient", low=-0.1, high=0.3, typical=0.01),),
    act=act,
    by_material=True,
    order=5,
)
