"""The skin over the joints is a spring that gives way with time.

A spring behind a damper beside each joint, a standard linear solid: the strain that the spring
has fades within ``relaxation_s``.

Taken for: elasticity or damping alone; slow and fast strokes tell.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, BodyParameter, Forces


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.skin[:, 2] += p["stiffness_Nm_per_rad"]
    robot.skin[:, 3] = p["relaxation_s"]


EFFECT = BodyEffect(
    name="skin_viscoelasticity",
    plain="a skin that springs back slowly",
    title="the skin over the joints is a spring that gives way with time",
    parameters=(
        BodyParameter("stiffness_Nm_per_rad", "N m/rad", 0.3, 0.0, 10.0),
        BodyParameter("relaxation_s", "s", 0.3, 0.02, 5.0),
    ),
    act=act,
    order=2,
)
