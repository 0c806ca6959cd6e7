"""The centre of mass is not where the file says, forwards and to the left.

Where all links' centres of mass are, forwards and to the left of where the file says.

Taken for: a marker that is off.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.com -= p["x_m"]
    robot.side += p["y_m"]


EFFECT = BodyEffect(
    name="com_offset",
    plain="a centre of mass that is off",
    title="offset of the centre of mass from the robot file's, forwards and to the left",
    parameters=(
        Parameter("x_m", low=-0.1, high=0.1, typical=0.01),
        Parameter("y_m", low=-0.05, high=0.05, typical=0.005),
    ),
    act=act,
    order=11,
)
