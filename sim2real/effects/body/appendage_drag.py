"""Drag of something on the robot that the robot file leaves out: an area, and where it is.

``force = -rho / 2 area speed v`` at a point of the axis, whose velocity is ``v``. The area includes
the drag coefficient, and is the same along the link and across it. ``x_m`` is the distance behind
the front of the straight robot. Confused with: form drag, which acts along the head only; skin
friction.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="drag of a part that the robot file leaves out",
    title="drag area that the robot file leaves out, and its distance behind the robot's front",
    parameters=(
        Parameter("area_m2", low=0.0, high=0.1, typical=0.002),
        Parameter("x_m", low=0.0, high=3.0, typical=0.1),
    ),
    adds=lambda _robot, p, _material: {"lacking": p["area_m2"], "lacking_at": p["x_m"]},
    order=6,
)
