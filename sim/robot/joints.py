"""Torques and impulses at a joint: the servo, dry friction, the joint's limits."""

import warp as wp

from sim.robot.chain import RING, Chain, Motion
from sim.robot.linear import response
from sim2real.servo.effect_chain import (
    command_in_force,
    error_seen,
    friction_bound,
    load_torque,
    motor_torque,
    shaft_inertia,
)
from sim2real.servo.motor import (
    MOTOR_BIT,
    Push,
    gear_friction,
    motor_push,
    pd_torque,
    read_motor,
    resistance,
)

_SWEEPS, _SETTLED = 100, wp.constant(wp.float64(1e-12))
"""Largest number of sweeps, and the change of a joint's rate in rad/s below which they end."""


@wp.func
def set_point(e: int, k: int, start: wp.float64, h: wp.float64, s: Motion) -> wp.float64:
    """Mean over the step of the set-point in force at joint k; NaN where the torque is off."""
    newest = s.newest[e, k]
    mean = wp.float64(0.0)
    until = start + h
    for back in range(wp.static(RING)):
        if newest - back >= 0 and until > start:
            slot = (newest - back) % wp.static(RING)
            since = wp.max(s.arrival[e, k, slot], start)
            if since < until:
                mean += s.sent[e, k, slot] * (until - since) / h
                until = since
    return mean


@wp.func
def drive(e: int, k: int, h: wp.float64, chain: Chain, s: Motion) -> wp.vec3d:
    """Impulse of servo k over a step, equivalent inertia of its gains, bound of dry friction.

    The torque is that at the middle of the step, as in ``sim2real.servo.law.substep``. Steps are
    not longer than the controller's period, so the controller is evaluated in each. The friction of
    the gears depends on the motor's torque; the load of the water, unknown before the step, is not
    included.
    """
    p = chain.servo[e, k]
    z = chain.memory[e, k]
    active = chain.active[e, k]
    zero = wp.float64(0.0)
    half = wp.float64(0.5) * h
    kp = p[0]
    kd = p[1]
    v = s.v[e, 3 + k]
    q = s.q[e, 3 + k] + half * v
    now = s.clock[e]
    u = set_point(e, k, now, h, s)
    if wp.isnan(u):
        kp = zero
        kd = zero
        u = q
    error = u - q
    load = zero
    inertia = zero
    bound = zero
    push = Push()
    push.torque = kp * error
    push.damping = kd
    push.stiffness = kp
    torque = pd_torque(kp, kd, error, v)
    explicit = bool(False)
    if active != wp.int64(0):
        before = s.torque[e, k]
        error = command_in_force(u, q, v, before, now, h, p, z, active) - q
        error = error_seen(error, q, v, before, now, h, p, z, active)
        load = load_torque(load, q, v, before, now, h, p, z, active)
        push.torque = kp * error
        if kp > zero and (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
            m = read_motor(p)
            push = motor_push(kp, kd, error, v, m)
            factor = wp.float64(1.0) / resistance(push, v, m)
            push.torque *= factor
            push.damping *= factor
            push.stiffness *= factor
        torque = push.torque - push.damping * v
        if kp > zero:
            modified = motor_torque(torque, q, v, torque, now, h, p, z, active)
            explicit = modified != torque
            torque = modified
        bound = friction_bound(zero, q, v, torque, now, h, p, z, active)
        if (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
            bound += gear_friction(v, torque, zero, read_motor(p))
        inertia = shaft_inertia(zero, p, z, active)
    s.torque[e, k] = torque
    rotor = inertia * v
    if explicit:
        return wp.vec3d(h * (torque + load) + rotor, inertia, h * bound)
    gain = half * push.damping + half * h * push.stiffness
    at_start = push.torque + push.stiffness * half * v  # without the implicit part
    impulse = h * (at_start - wp.float64(0.5) * push.damping * v + load) + rotor
    return wp.vec3d(impulse, gain + inertia, h * bound)


@wp.func
def stop_joints(
    e: int, size: int, h: wp.float64, friction: wp.array(dtype=wp.float64), chain: Chain, s: Motion
) -> int:
    """Apply impulses of dry friction and of the joints' limits to the velocities in ``b``."""
    J = size - 3
    any_bound = bool(False)
    for k in range(J):
        q = s.q[e, 3 + k] + h * s.b[e, 3 + k]
        if friction[k] > wp.float64(0.0) or q < chain.limits[k][0] or q > chain.limits[k][1]:
            any_bound = True
    if not any_bound:
        return 0
    for k in range(J):
        response(e, 3 + k, size, s)
        s.impulse[e, k] = wp.float64(0.0)
        s.stop[e, k] = wp.float64(0.0)
    largest = wp.float64(1.0)
    sweep = int(0)
    while sweep < wp.static(_SWEEPS) and largest > wp.static(_SETTLED):
        largest = wp.float64(0.0)
        sweep += 1
        for k in range(J):
            v = s.b[e, 3 + k]
            mobility = s.inverse[e, 3 + k, 3 + k]
            target = wp.clamp(s.impulse[e, k] - v / mobility, -friction[k], friction[k])
            change = target - s.impulse[e, k]
            s.impulse[e, k] = target
            v += mobility * change
            low = wp.min((chain.limits[k][0] - s.q[e, 3 + k]) / h, wp.float64(0.0))
            high = wp.max((chain.limits[k][1] - s.q[e, 3 + k]) / h, wp.float64(0.0))
            unstopped = v - mobility * s.stop[e, k]
            change -= s.stop[e, k]
            s.stop[e, k] = (wp.clamp(unstopped, low, high) - unstopped) / mobility
            change += s.stop[e, k]
            largest = wp.max(largest, wp.abs(change) * mobility)
            for i in range(size):
                s.b[e, i] += s.inverse[e, 3 + k, i] * change
    return 0
