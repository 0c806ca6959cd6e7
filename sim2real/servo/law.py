"""The servo's dynamics, once: every rollout, fit and simulator calls these Warp functions.

Symbols: u set-point, q angle, v speed of the output shaft (rad, rad/s); h length of a sub-step
(s); p row of the joint's parameters (see ``parameters.COLUMNS``); active, bit k set where effect k
of the catalogue is on. All float64, SI.
"""

from __future__ import annotations

import warp as wp

from sim2real.effects import CATALOGUE
from sim2real.servo.parameters import FIRST_COLUMN

Row = wp.array(dtype=wp.float64)

_TERMS = tuple((e.site, e.term, FIRST_COLUMN[e.name], 1 << k) for k, e in enumerate(CATALOGUE))


def _at(site: str) -> tuple[tuple[wp.Function, ...], tuple[int, ...], tuple[int, ...]]:
    """Terms, columns and bits of the effects that act at one site."""
    terms = [entry[1:] for entry in _TERMS if entry[0] == site]
    return tuple(t[0] for t in terms), tuple(t[1] for t in terms), tuple(t[2] for t in terms)


_INERTIA, _INERTIA_C, _INERTIA_BIT = _at("inertia")
_MOTOR, _MOTOR_C, _MOTOR_BIT = _at("motor")
_LOAD, _LOAD_C, _LOAD_BIT = _at("load")
_FRICTION, _FRICTION_C, _FRICTION_BIT = _at("friction")
_SENSOR, _SENSOR_C, _SENSOR_BIT = _at("sensor")


@wp.func
def pd_torque(kp: wp.float64, kd: wp.float64, error: wp.float64, v: wp.float64) -> wp.float64:
    """Torque of the servo, T = kp (J_des - J) - kd J'. Lin, Liu, Wang (2024), Sec. III-B.2."""
    return kp * error - kd * v


@wp.func
def motor_torque(
    torque: wp.float64, q: wp.float64, v: wp.float64, p: Row, active: int
) -> wp.float64:
    """What the motor makes of the torque that the controller asks for."""
    made = torque
    for k in range(wp.static(len(_MOTOR))):
        if (active & wp.static(_MOTOR_BIT[k])) != 0:
            made = wp.static(_MOTOR[k])(made, q, v, p, wp.static(_MOTOR_C[k]))
    return made


@wp.func
def load_torque(q: wp.float64, v: wp.float64, p: Row, active: int) -> wp.float64:
    """Torque on the shaft that is neither the motor's nor dry friction."""
    torque = wp.float64(0.0)
    if p[4] != wp.float64(0.0):
        torque = -p[4] * wp.sin(q)
    for k in range(wp.static(len(_LOAD))):
        if (active & wp.static(_LOAD_BIT[k])) != 0:
            torque += wp.static(_LOAD[k])(q, v, p, wp.static(_LOAD_C[k]))
    return torque


@wp.func
def friction_bound(
    q: wp.float64, v: wp.float64, torque: wp.float64, p: Row, active: int
) -> wp.float64:
    """Largest torque of dry friction."""
    bound = wp.float64(0.0)
    for k in range(wp.static(len(_FRICTION))):
        if (active & wp.static(_FRICTION_BIT[k])) != 0:
            bound += wp.static(_FRICTION[k])(q, v, torque, p, wp.static(_FRICTION_C[k]))
    return bound


@wp.func
def shaft_inertia(p: Row, active: int) -> wp.float64:
    """Inertia on the shaft."""
    inertia = p[3]
    for k in range(wp.static(len(_INERTIA))):
        if (active & wp.static(_INERTIA_BIT[k])) != 0:
            inertia += wp.static(_INERTIA[k])(p, wp.static(_INERTIA_C[k]))
    return inertia


@wp.func
def measured_angle(q: wp.float64, v: wp.float64, p: Row, active: int) -> wp.float64:
    """What the sensor says of angle q."""
    angle = q
    for k in range(wp.static(len(_SENSOR))):
        if (active & wp.static(_SENSOR_BIT[k])) != 0:
            angle = wp.static(_SENSOR[k])(angle, v, p, wp.static(_SENSOR_C[k]))
    return angle


@wp.func
def substep(
    state: wp.vec2d,
    u: wp.float64,
    h: wp.float64,
    kp: wp.float64,
    kd: wp.float64,
    inertia: wp.float64,
    p: Row,
    active: int,
) -> wp.vec2d:
    """Advance (q, v) by h under a constant set-point.

    Second order and symmetric: forces at the middle position, damping by the trapezoidal rule, dry
    friction as an impulse that can stop the shaft but not turn it round. Source: the Moreau-Jean
    scheme, Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems (Springer, 2008),
    ch. 10.
    """
    half = wp.float64(0.5) * h
    v = state[1]
    q = state[0] + half * v
    impulse = h / inertia
    damping = half * kd / inertia
    load = load_torque(q, v, p, active)
    stiff = wp.float64(1.0) / (wp.float64(1.0) + damping)
    after = ((wp.float64(1.0) - damping) * v + impulse * (kp * (u - q) + load)) * stiff
    if active != 0:
        torque = pd_torque(kp, kd, u - q, wp.float64(0.5) * (v + after))
        made = motor_torque(torque, q, v, p, active)
        if made != torque:
            after = v + impulse * (made + load)
        stop = impulse * stiff * friction_bound(q, v, made, p, active)
        if stop > wp.float64(0.0):
            return slide(state, after, stop, half)
    return wp.vec2d(q + half * after, after)


@wp.func
def slide(state: wp.vec2d, free: wp.float64, stop: wp.float64, half: wp.float64) -> wp.vec2d:
    """Apply dry friction to a sub-step that would end at speed ``free`` without it.

    ``stop`` is the change of speed that friction can make. Where the shaft comes to rest inside the
    sub-step, friction turns round there, so that reversals too are of second order.
    """
    v = state[1]
    after = free - wp.sign(v) * stop
    if v != wp.float64(0.0) and after * v >= wp.float64(0.0):
        return wp.vec2d(state[0] + half * (v + after), after)
    moving = wp.float64(0.0)
    if v != wp.float64(0.0):
        moving = v / (v - after)
    rest = wp.float64(1.0) - moving
    push = rest * (free - v)
    after = push - wp.clamp(push, -rest * stop, rest * stop)
    return wp.vec2d(state[0] + half * (moving * v + rest * after), after)


@wp.func
def resting_angle(u: wp.float64, kp: wp.float64, gravity: wp.float64) -> wp.float64:
    """Angle at which kp (u - q) balances gravity sin q, by Newton's method from u."""
    q = u
    if gravity != wp.float64(0.0):
        for _ in range(8):
            q += (kp * (u - q) - gravity * wp.sin(q)) / (kp + wp.abs(gravity * wp.cos(q)))
    return q
