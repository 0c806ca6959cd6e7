"""Change of the drag that is proportional to the speed of the body.

``force = -coefficient v``, distributed over the links in proportion to their lengths.

Confused with: form drag, skin friction; slow and fast swims distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.resist[:, 0] += p["coefficient"] * robot.lengths_m / robot.lengths_m.sum()


EFFECT = BodyEffect(
    name="linear_drag",
    plain="an error of the linear drag",
    title="change of the drag that is proportional to the speed of the body",
    parameters=(Parameter("coefficient", low=-5.0, high=20.0, typical=0.3, unit="N s/m"),),
    act=act,
    order=4,
)
