"""The pool's water moves evenly.

The water's velocity in the world's frame.

Taken for: a camera that is off; swims both ways tell.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim2real.effects.body_effect import BodyEffect, BodyParameter, Forces


def act(robot: Forces, p: Mapping[str, float], _material: str) -> None:
    """Add it to what acts on the robot."""
    robot.current += np.array([p["u_m_s"], p["v_m_s"]])


EFFECT = BodyEffect(
    name="pool_current",
    plain="a current in the pool",
    title="the pool's water moves evenly",
    parameters=(
        BodyParameter("u_m_s", "m/s", 0.02, -0.5, 0.5),
        BodyParameter("v_m_s", "m/s", 0.02, -0.5, 0.5),
    ),
    act=act,
    order=8,
)
