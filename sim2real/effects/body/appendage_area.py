"""Error of the drag areas of the appendages in the robot file, relative to them.

``area = (1 + ratio) area of the file`` for all appendages, along and across their links. It stands
for the coefficients, whose errors are alike: interference, turbulence, roughness. Confused with:
form drag, skin friction. It is fitted by a calibration, with the standard deviations of the
coefficients as prior, and not offered by a diagnosis.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an error of the drag areas of the appendages",
    title="change of the drag areas of the appendages, relative to the robot file",
    parameters=(Parameter("ratio", low=-0.95, high=5.0, typical=0.1),),
    adds=lambda _robot, p, _material: {"areas": p["ratio"]},
    order=6,
)
