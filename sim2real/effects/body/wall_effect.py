"""Near a wall the robot swims faster, by this share one body length away from it.

The reactive thrust is larger by ``ratio (length / gap)^2``.

Taken for: less drag; swims far from the walls tell.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, BodyParameter, Forces


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.wall += p["ratio"]


EFFECT = BodyEffect(
    name="wall_effect",
    plain="a wall nearby",
    title="near a wall the robot swims faster, by this share one body length away from it",
    parameters=(BodyParameter("ratio", "", 0.1, 0.0, 2.0),),
    act=act,
    order=10,
)
