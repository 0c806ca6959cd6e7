"""The skin over the joints damps their motion.

``torque = -damping q'`` at each joint. Confused with: the servo's damping; bench recordings with
and without the skin distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="damping by the skin",
    title="the skin over the joints acts as a damper",
    parameters=(Parameter("damping_Nms_per_rad", low=0.0, high=2.0, typical=0.03),),
    adds=lambda _robot, p, _material: {"skin": (0, p["damping_Nms_per_rad"], 0, 0)},
    order=1,
)
