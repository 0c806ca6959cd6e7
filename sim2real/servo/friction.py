"""Dry friction as an impulse, for the sub-steps of the servo law and of the gear train."""

import warp as wp


@wp.func
def slide(
    state: wp.vec4d,
    free: wp.float64,
    stop: wp.float64,
    half: wp.float64,
    torque: wp.float64,
    per_h: wp.float64,
) -> wp.vec4d:
    """Apply dry friction to a sub-step that would end at speed ``free`` without it.

    ``stop`` is the largest change of speed by friction. Where the shaft comes to rest inside the
    sub-step, friction changes its direction there, so that reversals are of second order as well.
    """
    v = state[1]
    after = free - wp.sign(v) * stop
    if v != wp.float64(0.0) and after * v >= wp.float64(0.0):
        return wp.vec4d(state[0] + half * (v + after), after, torque, (after - v) * per_h)
    moving = wp.float64(0.0)
    if v != wp.float64(0.0):
        moving = v / (v - after)
    resting = wp.float64(1.0) - moving
    push = resting * (free - v)
    after = push - wp.clamp(push, -resting * stop, resting * stop)
    return wp.vec4d(
        state[0] + half * (moving * v + resting * after),
        after,
        torque,
        (after - v) * per_h,
    )
