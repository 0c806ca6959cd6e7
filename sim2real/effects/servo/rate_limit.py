"""Rate limit: the servo limits the speed of its internal set-point to ``limit_rad_s``.

A profile generator of constant speed, such as the time field of bus servos. Residual: straight
ramps after steps, their duration proportional to the step. Confused with: torque saturation,
voltage sag; another supply voltage or inertia distinguishes them, as neither changes the ramp.
"""

from sim2real.effects.effect import LIMITS, Effect, F, Parameter, Row, wp


@wp.func
def ramp(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if z[s + 1] == wp.float64(0.0):
        z[s] = x
        z[s + 1] = wp.float64(1.0)
    most = p[c] * h
    move = wp.clamp(x - z[s], -most, most)
    z[s] += move
    share = wp.abs(move) / wp.max(most, wp.float64(1e-12))  # of the sub-step in which it moves
    return z[s] - wp.float64(0.5) * share * move  # its mean over the sub-step


EFFECT = Effect(
    plain="a rate limit of the set-point",
    says="the servo limits the speed of its set-point to {limit_rad_s}",
    site="command",
    term=ramp,
    parameters=(Parameter("limit_rad_s", low=0.03, high=500.0, typical=3.0, starts=LIMITS),),
    memory=2,
)
