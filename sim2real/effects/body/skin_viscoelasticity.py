"""The skin over the joints is a spring that gives way with time.

A spring behind a damper beside each joint, a standard linear solid: the strain that the spring
has fades within ``relaxation_s``.

Taken for: elasticity or damping alone; slow and fast strokes tell.
"""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.skin[:, 2] += p["stiffness_Nm_per_rad"]
    robot.skin[:, 3] = p["relaxation_s"]


EFFECT = BodyEffect(
    name="skin_viscoelasticity",
    plain="a skin that springs back slowly",
    title="the skin over the joints acts as a spring that relaxes with time",
    parameters=(
        Parameter("stiffness_Nm_per_rad", low=0.0, high=10.0, typical=0.3),
        Parameter("relaxation_s", low=0.02, high=5.0, typical=0.3),
    ),
    act=act,
    order=2,
)
