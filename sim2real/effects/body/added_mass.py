"""Change of the added mass of the links, as a share of the displaced water.

Acts on each link's motion normal to its axis and in rotation.

Confused with: drag normal to the links; accelerations distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Forces, Parameter, Values


def _act(robot: Forces, p: Values, _material: str) -> None:
    robot.resist[:, 2:] += p["ratio"]


EFFECT = BodyEffect(
    name="added_mass",
    plain="an error of the added mass",
    title="change of the transverse added mass, as a share of the displaced water",
    parameters=(Parameter("ratio", low=-0.5, high=2.0, typical=0.2),),
    act=_act,
    order=7,
)
