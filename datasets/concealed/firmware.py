"""The servo's firmware: a control loop at 1 kHz that turns an error of angle into a duty cycle.

A set-point that arrives runs the loop at once and restarts its timer, so that a latency need not be
a whole number of ticks. Between ticks the duty cycle is held.
"""

from __future__ import annotations

import numpy as np
from numba import njit

TICK_S = 1e-3
INTEGRAL_LIMIT = 0.5  # of the duty cycle


@njit
def profile_acceleration(error, speed, most, h):
    """Time-optimal acceleration to rest at error 0, without chatter, for a step of ``h`` s.

    Han's fhan, as in "From PID to Active Disturbance Rejection Control" (2009), section III.
    """
    d = most * h * h
    a0 = h * speed
    y = error + a0
    a1 = np.sqrt(d * (d + 8.0 * abs(y)))
    a2 = a0 + np.sign(y) * (a1 - d) / 2.0
    near = a0 + y if abs(y) <= d else a2
    return -most * near / d if abs(near) <= d else -most * np.sign(near)


@njit
def advance_target(p, target, target_speed, setpoint, dt):
    """The internal set-point and its speed, ``dt`` s after it began to follow ``setpoint``."""
    if dt <= 0.0:
        return target, target_speed
    if p.acceleration_rad_s2 < np.inf:
        a = profile_acceleration(target - setpoint, target_speed, p.acceleration_rad_s2, dt)
        return target + dt * target_speed, target_speed + dt * a
    if p.rate_rad_s < np.inf:
        most = p.rate_rad_s * dt
        return target + min(max(setpoint - target, -most), most), 0.0
    if p.filter_s > 0.0:
        return setpoint + (target - setpoint) * np.exp(-dt / p.filter_s), 0.0
    return setpoint, 0.0


@njit
def shaped_target(p, target, setpoint):
    """What the error is taken from: the internal set-point, or the last one received."""
    shaped = p.acceleration_rad_s2 < np.inf or p.rate_rad_s < np.inf or p.filter_s > 0.0
    return target if shaped else setpoint


@njit
def duty_cycle(p, error, speed, integral):
    """Duty cycle before its limit of -1 to 1; ``integral`` is that of the error, in rad s."""
    size = max(abs(error) - p.deadband_rad, 0.0)
    if size > p.schedule_rad:
        size = p.schedule_rad + p.schedule_factor * (size - p.schedule_rad)
    pull = p.gain_per_rad * size * np.sign(error)
    return pull - p.damping_s * speed + p.integral_per_rad_s * integral


@njit
def advance_integral(p, integral, error, dt):
    """The integral of the error, rad s, held where it would ask for too much."""
    if p.integral_per_rad_s == 0.0:
        return 0.0
    most = INTEGRAL_LIMIT / p.integral_per_rad_s
    return min(max(integral + error * dt, -most), most)
