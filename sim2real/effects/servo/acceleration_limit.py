"""Acceleration limit: the servo limits the acceleration of its internal set-point.

A time-optimal profile: full acceleration until full braking stops exactly at the set-point (at
distance d and speed w for another ``(sqrt(w^2 / 2 + limit d) - w) / limit`` seconds), then full
braking. Exact over a sub-step. Residual: rounded ramps. Confused with: command filter; steps of
several sizes distinguish them, as the duration grows with the square root of the step.
"""

from sim2real.effects.effect import LIMITS, Effect, F, Parameter, Row, wp


@wp.func
def brake(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if z[s + 2] == wp.float64(0.0):
        z[s] = x
        z[s + 2] = wp.float64(1.0)
    limit = p[c]
    before = z[s]
    towards = wp.sign(x - before)
    away = wp.abs(x - before)
    speed = towards * z[s + 1]
    until_brake = (wp.sqrt(wp.float64(0.5) * speed * speed + limit * away) - speed) / limit
    faster = wp.clamp(until_brake, wp.float64(0.0), h)
    top = speed + limit * faster
    slower = wp.clamp(top / limit, wp.float64(0.0), h - faster)
    after = top - limit * slower
    moved = wp.float64(0.5) * ((speed + top) * faster + (top + after) * slower)
    z[s] = before + towards * moved
    z[s + 1] = towards * after
    return wp.float64(0.5) * (before + z[s])  # its mean over the sub-step


EFFECT = Effect(
    plain="an acceleration limit of the set-point",
    says="the servo limits the acceleration of its set-point to {limit_rad_s2}",
    site="command",
    term=brake,
    parameters=(Parameter("limit_rad_s2", low=0.6, high=10000.0, typical=60.0, starts=LIMITS),),
    memory=3,
    order=1,
)
