"""Torques on a mass: of the PD law, of a pendulum, of dry friction as an impulse; its motion."""

import warp as wp

from sim2real.effects.elementary import sine


@wp.func
def pd_torque(kp: wp.float64, kd: wp.float64, error: wp.float64, v: wp.float64) -> wp.float64:
    """Torque of the servo, T = kp (J_des - J) - kd J'. Lin, Liu, Wang (2024), Sec. III-B.2."""
    return kp * error - kd * v


@wp.func
def pendulum_torque(q: wp.float64, gravity: wp.float64) -> wp.float64:
    """Torque of the stated load's weight."""
    if gravity == wp.float64(0.0):
        return wp.float64(0.0)
    return -gravity * sine(q)


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
        state[0] + half * (moving * v + resting * after), after, torque, (after - v) * per_h
    )


@wp.func
def free_mass(
    q: wp.float64,
    v: wp.float64,
    torque: wp.float64,
    damping: wp.float64,
    inertia: wp.float64,
    dry: wp.float64,
    h: wp.float64,
) -> wp.vec2d:
    """Angle and speed of a mass after h, under a torque, damping and dry friction."""
    half = wp.float64(0.5) * h
    damp = half * damping
    per = wp.float64(1.0) / (inertia + damp)
    free = ((inertia - damp) * v + h * torque) * per
    if dry > wp.float64(0.0):
        state = wp.vec4d(q, v, wp.float64(0.0), wp.float64(0.0))
        after = slide(state, free, h * dry * per, half, torque, wp.float64(0.0))
        return wp.vec2d(after[0], after[1])
    return wp.vec2d(q + half * (v + free), free)
