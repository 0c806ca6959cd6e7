"""The positions of the camera have a relative scale error.

``position (1 + ratio)``. Confused with: a slower or a faster robot; a ruler in the image
distinguishes them.
"""

from sim2real.effects.body_effect import CameraEffect, Parameter

EFFECT = CameraEffect(
    plain="a scale error of the camera",
    title="scale error of the camera's positions",
    parameters=(Parameter("ratio", low=-0.3, high=0.3, typical=0.02),),
    see=lambda _t, pose, p: pose * [1 + p["ratio"], 1 + p["ratio"], 1.0],
    order=5,
)
