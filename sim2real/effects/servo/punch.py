"""Punch: the firmware adds a minimum drive to any error, so the gain is larger for small errors.

``drive = kp error + torque clip(error / width, -1, 1)``: ``width`` is about one count of the
encoder, below which there is no error. Observed in the drive that STS3215 servos report (public
logs of a backlash test stand by B. Kotov, 2025): 0.8 or 1.3 % of the full drive per count of 1.53
mrad, and an additional 1.6 %, with and without a dead band of one count. Residual: smaller errors
at rest than in motion, and oscillation about the set-point where friction is small. Confused with:
less friction, a larger kp; small and large steps under one load distinguish them, as the gains
differ.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def punched(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Error in rad to which the proportional gain answers."""
    if p[0] <= wp.float64(0.0):
        return x
    width = wp.max(p[c + 1], wp.float64(1e-6))
    return x + p[c] / p[0] * wp.clamp(x / width, wp.float64(-1.0), wp.float64(1.0))


EFFECT = Effect(
    plain="a minimum drive added by the firmware",
    says="the firmware adds {torque_Nm} to the drive at position errors beyond {width_rad}",
    site="error",
    term=punched,
    parameters=(
        Parameter("torque_Nm", low=0.0, high=1.0, typical=0.1),
        Parameter("width_rad", low=2e-4, high=0.02, typical=1.5e-3),
    ),
    order=1,
)
