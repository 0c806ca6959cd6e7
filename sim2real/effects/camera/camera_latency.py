"""The poses of the camera are delayed.

``pose(t) = true pose(t - latency)``. Confused with: the servos' latency, where no angles are
recorded.
"""

from sim2real.effects.body_effect import CameraEffect, Parameter, late

EFFECT = CameraEffect(
    plain="latency of the camera",
    title="delay of the camera's poses",
    parameters=(Parameter("latency_s", low=-0.05, high=0.5, typical=0.05),),
    see=lambda t, pose, p: late(t, pose, p["latency_s"]),
    order=1,
)
