"""Change of the skin friction of a material, which is quadratic in speed.

``force = -rho / 2 coefficient area u^2`` along each link of the material. Confused with: form drag,
which grows with speed in the same way.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an error of the skin friction",
    title="change of the skin friction coefficient of the surface",
    parameters=(Parameter("coefficient", low=-0.1, high=0.3, typical=0.01),),
    adds=lambda robot, p, material: {"rough": p["coefficient"] * robot.made_of(material)},
    by_material=True,
    order=5,
)
