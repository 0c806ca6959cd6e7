"""Backlash: play between the motor's side, which is controlled, and the output, which is seen.

The output lies against the flank that the torque pushes it to, half of ``gap_rad`` to either side;
when the torque turns round, it crosses the gap as the load's inertia lets it, and stops at the
other flank without bouncing: ``z'' = -torque / inertia`` while ``|z| < gap / 2``, the angle seen
being ``q + z`` (two masses and a dead zone, Nordin, Gutman, Automatica 38 (2002) 1633-1649, Sec. 2,
with stiff flanks and what the crossing does to the motor left out).

Leaves jumps of the gap's size where the torque changes its sign. Taken for: dead band, Coulomb
friction; three amplitudes tell.
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
    if z[s + 2] == wp.float64(0.0):
        z[s] = -half * wp.sign(torque)
        z[s + 2] = wp.float64(1.0)
    speed = z[s + 1] - h * torque / p[3]
    place = z[s] + wp.float64(0.5) * h * (z[s + 1] + speed)
    if wp.abs(place) >= half:
        place = wp.clamp(place, -half, half)
        speed = wp.float64(0.0)
    z[s] = place
    z[s + 1] = speed
    return x + place


EFFECT = Effect(
    name="backlash",
    plain="play in the gears",
    says="the gears have {gap_rad} of play",
    site="sensor",
    term=play,
    parameters=(Parameter("gap_rad", low=0.0, high=0.3, typical=0.03),),
    memory=3,
    order=1,
)
