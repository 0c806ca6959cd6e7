"""A uniform current in the pool.

The water's velocity in the world frame.

Confused with: a position error of the camera; swims in both directions distinguish them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import BodyEffect, Forces
from sim2real.inference.parameters import Parameter


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add the effect to the forces on the robot."""
    robot.current += np.array([p["u_m_s"], p["v_m_s"]])


EFFECT = BodyEffect(
    name="pool_current",
    plain="a current in the pool",
    title="uniform current in the pool",
    parameters=(
        Parameter("u_m_s", low=-0.5, high=0.5, typical=0.02),
        Parameter("v_m_s", low=-0.5, high=0.5, typical=0.02),
    ),
    act=act,
    order=8,
)
