"""A cable pulls the head to a place in the pool.

``force = stiffness (anchor - head)``.

Taken for: a current; where the swim ends tells.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, BodyParameter, Forces


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.tether[:] = p["stiffness_N_per_m"], p["x_m"], p["y_m"]


EFFECT = BodyEffect(
    name="tether",
    plain="a tether that pulls",
    title="a cable pulls the head to a place in the pool",
    parameters=(
        BodyParameter("stiffness_N_per_m", "N/m", 0.1, 0.0, 10.0),
        BodyParameter("x_m", "m", 0.5, -10.0, 10.0),
        BodyParameter("y_m", "m", 0.5, -10.0, 10.0),
    ),
    act=act,
    order=9,
)
