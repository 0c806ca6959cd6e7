"""All joints have the same offset angle.

``q = 0`` is displaced by ``offset_rad`` at every joint. Confused with: a lateral current; swims in
both directions distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="a trim offset of the joints",
    title="offset of all joint zeros by the same angle",
    parameters=(Parameter("offset_rad", low=-0.5, high=0.5, typical=0.03),),
    adds=lambda _robot, p, _material: {"trim": p["offset_rad"]},
    order=12,
)
