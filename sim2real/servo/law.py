"""Dynamics of the servo: the Warp functions that all rollouts, fits and simulators call.

Symbols: u set-point, q angle, v speed of the output shaft (rad, rad/s); h length of a sub-step
(s); p row of the joint's parameters (see ``parameters.COLUMNS``); z its memory; active, bit k set
where effect k of the catalogue is on and ``MOTOR_BIT`` where the motor is not linear (see
``motor``). All float64, SI.
"""

import warp as wp

from sim2real.effects.effect import F, Row
from sim2real.servo import effect_chain as sites
from sim2real.servo.gear_train import TRAIN_BITS, Train, train_substep
from sim2real.servo.motor import (
    MOTOR_BIT,
    Motor,
    drive_push,
    gear_friction,
    pd_torque,
    pendulum_torque,
    resistance,
    slide,
    soft_stop,
    softness,
)
from sim2real.servo.parameters import FIRST_COLUMN, LOAD_CELL

_LIMIT = FIRST_COLUMN["torque_saturation"]


def substep_of(effects: bool) -> wp.Function:
    """The sub-step of servos with effects, or a faster one of servos without.

    It advances (q, v, motor torque, acceleration) by h under a constant set-point. Second order and
    symmetric: forces at the middle position, damping by the trapezoidal rule, dry friction as an
    impulse that can stop the shaft but not reverse it. Source: the Moreau-Jean scheme, Acary and
    Brogliato, Numerical Methods for Nonsmooth Dynamical Systems (Springer, 2008), ch. 10. ``tick``
    is true if a sampled controller measures at the start of the sub-step.
    """
    mask = ~MOTOR_BIT if effects else 0

    @wp.func
    def substep(
        state: wp.vec4d,
        u: F,
        time: F,
        h: F,
        kp: F,
        kd: F,
        inertia: F,
        g: Train,
        m: Motor,
        p: Row,
        z: Row,
        active: wp.int64,
        tick: bool,
    ) -> wp.vec4d:
        half = wp.float64(0.5) * h
        v = state[1]
        q = state[0] + half * v
        speed = v + half * state[3]  # approximates the speed at the middle
        per_h = wp.float64(1.0) / h
        impulse = h / inertia
        damp = wp.float64(0.5) * impulse
        damping = damp * kd
        stiff = wp.float64(1.0) / (wp.float64(1.0) + damping)
        load = pendulum_torque(q, p[4]) + z[wp.static(LOAD_CELL)]
        weight = load
        error = u - q
        others = active & wp.static(wp.int64(mask))
        if (others & wp.static(wp.int64(TRAIN_BITS))) != wp.int64(0):
            return train_substep(state, u, time, h, kp, kd, g, m, p, z, active, tick)
        if others != wp.int64(0):
            error = sites.command_in_force(u, q, speed, state[2], time, h, p, z, active) - q
            error = sites.error_seen(error, q, speed, state[2], time, h, p, z, active)
            load = sites.load_torque(load, q, speed, state[2], time, h, p, z, active)
        after = ((wp.float64(1.0) - damping) * v + impulse * (kp * error + load)) * stiff
        middle = wp.float64(0.5) * (v + after)
        torque = pd_torque(kp, kd, error, middle)
        if active == wp.int64(0):
            return wp.vec4d(q + half * after, after, torque, wp.float64(0.0))
        zero = wp.float64(0.0)
        dry = wp.float64(0.0)
        if (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
            if kp > zero:
                push = drive_push(kp, kd, error, half, v, middle, tick, m, z)
                rise = resistance(push, speed, m)
                weaker = wp.float64(1.0) / rise
                damping = damp * push.damping
                per = wp.float64(1.0) / (rise + damping)
                # (rise - damping) v + impulse (push + rise load), over rise + damping
                lost = wp.float64(2.0) * v + impulse * load
                after = v + impulse * load + per * (impulse * push.torque - damping * lost)
                stiff = wp.float64(1.0) - damping * per
                middle = wp.float64(0.5) * (v + after)
                torque = (push.torque - push.damping * middle) * weaker
                dry = gear_friction(speed, (push.torque - push.damping * speed) * weaker, weight, m)
            else:
                dry = gear_friction(speed, torque, weight, m)
        if others != wp.int64(0):
            if kp > zero:
                output = sites.motor_torque(torque, q, middle, torque, time, h, p, z, active)
                if output != torque:
                    beyond = p[wp.static(_LIMIT + 1)] * p[1]
                    drive = output + beyond * middle
                    if wp.abs(wp.abs(drive) - p[wp.static(_LIMIT)]) <= wp.float64(1e-12):
                        # At the limit only this share of the damping remains.
                        stiff = wp.float64(1.0) / (wp.float64(1.0) + damp * beyond)
                        after = (
                            (wp.float64(1.0) - damp * beyond) * v + impulse * (drive + load)
                        ) * stiff
                        output = drive - beyond * wp.float64(0.5) * (v + after)
                    else:
                        after += impulse * stiff * (output - torque)
                torque = output
            if (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
                dry = gear_friction(speed, torque, weight, m)
            direction = speed
            if v == zero:
                direction = wp.float64(1e-9) * wp.sign(after)  # opposes the impending motion
            dry = sites.friction_bound(dry, q, direction, torque, time, h, p, z, active)
        stop = impulse * stiff * dry
        if stop > zero:
            if (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0) and softness(m) > zero:
                slowed = after - wp.clamp(after - soft_stop(v, after, h, m), -stop, stop)
                return wp.vec4d(q + half * slowed, slowed, torque, (slowed - v) * per_h)
            return slide(state, after, stop, half, torque, per_h)
        return wp.vec4d(q + half * after, after, torque, (after - v) * per_h)

    return substep


@wp.func
def resting_angle(u: F, kp: F, gravity: F, torque: F) -> F:
    """Angle at which kp (u - q) balances gravity sin q - torque, by Newton's method."""
    q = u
    if torque != wp.float64(0.0):
        q += torque / kp
    if gravity != wp.float64(0.0):
        for _ in range(8):
            balance = kp * (u - q) + torque - gravity * wp.sin(q)
            q += balance / (kp + wp.abs(gravity * wp.cos(q)))
    return q
