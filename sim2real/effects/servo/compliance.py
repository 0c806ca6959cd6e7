"""Compliance: a spring between the shaft, whose angle is controlled and seen, and its load.

Below the resonance of load and spring the shaft leads the load by ``compliance * torque``, and the
motor works against load and spring in series: with x what PD control of the load's angle would ask,
``torque (1 + kp compliance) + kd compliance torque' = x``; the angle seen is
``q + compliance * torque`` (two masses and a spring, the shaft's own inertia left out; any text on
flexible-joint robots, such as Spong, Journal of Dynamic Systems 109 (1987) 310-318).

Leaves error in proportion to torque, most where it changes fast. Taken for: kp, kd, a filter; known
added inertia tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def soften(
    x: wp.float64,
    q: wp.float64,
    v: wp.float64,
    torque: wp.float64,
    time: wp.float64,
    h: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
    z: wp.array(dtype=wp.float64),
    s: int,
) -> wp.float64:
    """Torque that the motor makes in N m."""
    share = wp.float64(1.0) + p[0] * p[c]
    settled = x / share
    if z[s + 1] == wp.float64(0.0):
        z[s] = settled
        z[s + 1] = wp.float64(1.0)
    before = z[s]
    left = wp.float64(0.0)
    if p[1] > wp.float64(0.0):
        left = wp.exp(-h * share / (p[1] * p[c]))
    z[s] = settled + (before - settled) * left
    return wp.float64(0.5) * (before + z[s])


@wp.func
def twist(
    x: wp.float64,
    q: wp.float64,
    v: wp.float64,
    torque: wp.float64,
    time: wp.float64,
    h: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
    z: wp.array(dtype=wp.float64),
    s: int,
) -> wp.float64:
    """Measured angle in rad."""
    return x + p[c] * torque


EFFECT = Effect(
    name="compliance",
    plain="a springy load",
    says="shaft and load are joined by a spring that gives {compliance_rad_per_Nm}",
    site="motor",
    term=soften,
    parameters=(Parameter("compliance_rad_per_Nm", low=0.0, high=0.5, typical=0.02),),
    memory=2,
    also=(("sensor", twist),),
    steady=True,
)
