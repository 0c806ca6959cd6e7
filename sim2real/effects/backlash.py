"""Backlash: play between the shaft and what the sensor sees, ``gap_rad`` wide in all.

The play operator: the far side rests until the near side has crossed the gap, then follows it
(Nordin, Gutman, Automatica 38 (2002) 1633-1649, the friction-driven dead-zone hysteresis).

Leaves dead intervals after reversals, whose phase lag falls with amplitude. Taken for: dead band,
Coulomb friction; three amplitudes tell.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def play(
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
    half = wp.float64(0.5) * p[c]
    if z[s + 1] == wp.float64(0.0):
        z[s] = x
        z[s + 1] = wp.float64(1.0)
    z[s] = wp.clamp(z[s], x - half, x + half)
    return z[s]


EFFECT = Effect(
    name="backlash",
    site="sensor",
    term=play,
    parameters=(Parameter("gap_rad", low=0.0, high=0.3, typical=0.03),),
    memory=2,
    order=1,
)
