"""Change of the form drag of the body, which is quadratic in speed.

``force = -rho / 2 coefficient area u^2`` along the head; the largest cross-section. Confused with:
skin friction, which grows with speed in the same way.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an error of the form drag",
    title="change of the form drag, which is proportional to the squared speed",
    parameters=(Parameter("coefficient", low=-1.0, high=3.0, typical=0.1),),
    adds=lambda robot, p, _material: {
        "resist": robot.on_head(0.5 * robot.water_kg_m3 * robot.frontal_m2 * p["coefficient"])
    },
    order=6,
)
