"""Change of the added mass of the links, as a share of the displaced water.

Acts on each link's motion normal to its axis and in rotation. Confused with: drag normal to the
links; accelerations distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="an error of the added mass",
    title="change of the transverse added mass, as a share of the displaced water",
    parameters=(Parameter("ratio", low=-0.5, high=2.0, typical=0.2),),
    adds=lambda _robot, p, _material: {"resist": (0, 0, p["ratio"], p["ratio"])},
    order=7,
)
