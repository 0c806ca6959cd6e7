"""Near a wall the thrust is larger, by this share at a distance of one body length.

The reactive thrust is larger by ``ratio (length / gap)^2``. Confused with: less drag; swims far
from the walls distinguish them.
"""

from sim2real.effects.body_effect import BodyEffect, Parameter

EFFECT = BodyEffect(
    plain="the effect of a nearby wall",
    title="gain of thrust near a wall, as a share at a distance of one body length",
    parameters=(Parameter("ratio", low=0.0, high=2.0, typical=0.1),),
    adds=lambda _robot, p, _material: {"wall": p["ratio"]},
    order=10,
)
