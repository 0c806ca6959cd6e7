"""A uniform current in the pool.

The water's velocity in the world frame.

Confused with: a position error of the camera; swims in both directions distinguish them.
"""

import numpy as np

from sim2real.effects.body_effect import BodyEffect, Forces, Parameter, Values


def _act(robot: Forces, p: Values, _material: str) -> None:
    robot.current += np.array([p["u_m_s"], p["v_m_s"]])


EFFECT = BodyEffect(
    name="pool_current",
    plain="a current in the pool",
    title="uniform current in the pool",
    parameters=(
        Parameter("u_m_s", low=-0.5, high=0.5, typical=0.02),
        Parameter("v_m_s", low=-0.5, high=0.5, typical=0.02),
    ),
    act=_act,
    order=8,
)
