"""The centre of mass is displaced from the stated one, forward and to the left.

All links' centres of mass are displaced by the same distances. Confused with: an offset of the
marker.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an offset of the centre of mass",
    title="offset of the centre of mass from the robot file's, forwards and to the left",
    parameters=(
        Parameter("x_m", low=-0.1, high=0.1, typical=0.01),
        Parameter("y_m", low=-0.05, high=0.05, typical=0.005),
    ),
    adds=lambda _robot, p, _material: {"com": -p["x_m"], "side": p["y_m"]},
    order=11,
)
