"""Torques of a servo: a limited drive, a motor on its torque-speed line, gear friction, a weight.

With T = kp e - kd v the torque of the linear servo, K the stall torque, w the no-load speed and
b = K / w the damping by the back-EMF::

    drive   d = clip(T + b v, -K, K)                           limit of the bridge
    motor   m (1 + r |m| / K) = d - b v                        r: rise of resistance with current
    dry     Kc + |Km m - Ke l| + exp(-(v / vs)^2) |Ksm m - Kse l|

where l is the weight of the load. Damping beyond that of the line (kd > b) is due to the
controller; a proportional controller has kd = b and the drive clip(kp e). Without limits, losses
and friction this is the linear servo. A sampled controller measures angle and speed once per
period, starting at its phase, and holds its drive in between; the back-EMF acts continuously.

Dry friction stops the shaft at once or gradually: while it is below its bound, the speed v tends to
the creep speed tc a, where a is the acceleration of the shaft without dry friction::

    v' = (tc a - v) / (ts + tc)                                ts: sticking, tc: creeping

so that ts = tc = 0 is Coulomb friction and ts = 0 is friction that is viscous near standstill.

Sources: the circuit of a DC motor behind a bridge (any text on motors); friction: Duclusaud,
Passault, Padois, Ly, Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA
2025, the directional model with a Stribeck part (with the exponent 2 of
``effects.stribeck_friction``). Gradual stopping: MuJoCo's documentation, Computation, Constraint
model (friction loss; impedance d and rate b give ts = 1 / b and tc = ts (1 - d) / d, 9.5 and
1.06 ms by default).

Symbols and units as in ``law``; ``p`` is the joint's row of parameters, ``m`` its motor.
"""

import warp as wp

from sim2real.effects import MOST_EFFECTS
from sim2real.effects.effect import F, Row
from sim2real.effects.elementary import decay, sine
from sim2real.servo.parameters import FIRST_MOTOR_COLUMN, HELD_CELL, MOTOR

MOTOR_BIT = -(1 << MOST_EFFECTS)
"""Bit of the mask of active effects that is set where the law is not linear."""


def _column(name: str) -> int:
    return FIRST_MOTOR_COLUMN + MOTOR.index(f"motor.{name}")


_NO_EXPONENT = wp.constant(wp.float64(36.0))
"""Exponent from which exp(-x) is below the rounding of 1."""


@wp.struct
class Motor:
    """A motor and its gears, read from a row once for many sub-steps; symbols as above.

    ``line`` is b, 0 where no line is known; ``per_stall`` is 1 / K or 0, ``per_slow`` 1 / vs.
    """

    stall: wp.float64
    per_stall: wp.float64
    line: wp.float64
    rise: wp.float64
    rotor: wp.float64
    coulomb: wp.float64
    of_motor: wp.float64
    of_load: wp.float64
    slow_of_motor: wp.float64
    slow_of_load: wp.float64
    per_slow: wp.float64
    stick: wp.float64
    creep: wp.float64
    period: wp.float64
    phase: wp.float64


@wp.func
def read_motor(p: Row) -> Motor:
    """The motor of a row of parameters."""
    m = Motor()
    m.stall = p[wp.static(_column("stall_torque_Nm"))]
    if m.stall > wp.float64(0.0):
        m.per_stall = wp.float64(1.0) / m.stall
        no_load = p[wp.static(_column("no_load_speed_rad_s"))]
        if no_load > wp.float64(0.0):
            m.line = m.stall / no_load
    m.rise = p[wp.static(_column("resistance_rise"))]
    m.rotor = p[wp.static(_column("rotor_inertia_kgm2"))]
    m.coulomb = p[wp.static(_column("coulomb_Nm"))]
    m.of_motor = p[wp.static(_column("motor_friction"))]
    m.of_load = p[wp.static(_column("load_friction"))]
    m.slow_of_motor = p[wp.static(_column("stribeck_motor_friction"))]
    m.slow_of_load = p[wp.static(_column("stribeck_load_friction"))]
    slow = p[wp.static(_column("stribeck_speed_rad_s"))]
    m.per_slow = wp.float64(1.0) / wp.max(slow, wp.float64(1e-12))
    m.stick = p[wp.static(_column("stick_time_s"))]
    m.creep = p[wp.static(_column("creep_time_s"))]
    m.period = p[wp.static(_column("loop_period_s"))]
    m.phase = p[wp.static(_column("loop_phase_s"))]
    return m


@wp.struct
class Push:
    """Torque of the motor during a sub-step: ``torque - damping * speed``.

    ``stiffness`` is the derivative of ``torque`` by the error, 0 where the drive clips. ``seen`` is
    1 where the error is that of a gear train's output, 0 where it is the motor's, and
    ``seen_damping`` the part of the damping that acts on the output's speed.
    """

    torque: wp.float64
    damping: wp.float64
    stiffness: wp.float64
    seen: wp.float64
    seen_damping: wp.float64


@wp.func
def back_emf(kd: F, m: Motor) -> F:
    """Damping b of the torque-speed line, N m s; ``kd`` where no line is known."""
    return wp.where(m.line > wp.float64(0.0), m.line, kd)


@wp.func
def wanted_drive(kp: F, kd: F, error: F, v: F, m: Motor) -> F:
    """Drive that the controller commands, before it is clipped, in N m at stall."""
    return kp * error - (kd - back_emf(kd, m)) * v


@wp.func
def motor_push(kp: F, kd: F, error: F, free: F, m: Motor) -> Push:
    """Torque and damping of a motor of constant resistance.

    ``free`` is the speed that the linear servo would have in the middle of the sub-step.
    """
    push = Push()
    push.torque = kp * error
    push.damping = kd
    push.stiffness = kp
    drive = wanted_drive(kp, kd, error, free, m)
    if m.stall > wp.float64(0.0) and wp.abs(drive) > m.stall:
        push.torque = wp.clamp(drive, -m.stall, m.stall)
        push.damping = back_emf(kd, m)
        push.stiffness = wp.float64(0.0)
    return push


@wp.func
def held_push(drive: F, kd: F, m: Motor) -> Push:
    """Torque and damping for a drive that the controller holds."""
    push = Push()
    push.torque = drive
    if m.stall > wp.float64(0.0):
        push.torque = wp.clamp(drive, -m.stall, m.stall)
    push.damping = back_emf(kd, m)
    return push


@wp.func
def drive_push(
    kp: F, kd: F, error: F, half: F, v: F, middle: F, tick: bool, m: Motor, z: Row
) -> Push:
    """Torque and damping of the drive, which a sampled controller updates at each ``tick``.

    ``v`` is the speed at the start of a sub-step of 2 ``half``, ``middle`` that in its middle.
    """
    if tick:
        z[wp.static(HELD_CELL)] = wanted_drive(kp, kd, error + half * v, v, m)
    push = motor_push(kp, kd, error, middle, m)
    if m.period > wp.float64(0.0):
        push = held_push(z[wp.static(HELD_CELL)], kd, m)
    return push


@wp.func
def resistance(push: Push, v: F, m: Motor) -> F:
    """The motor's resistance at speed ``v`` over that of a motor at rest: 1 + r |m| / K.

    The torque of the motor is that of ``push`` divided by this ratio.
    """
    if m.rise == wp.float64(0.0):
        return wp.float64(1.0)
    size = wp.abs(push.torque - push.damping * v)
    return wp.float64(0.5) + wp.sqrt(wp.float64(0.25) + m.rise * m.per_stall * size)


@wp.func
def gear_friction(v: F, torque: F, load: F, m: Motor) -> F:
    """Largest torque of dry friction in bearings and gears, N m."""
    bound = m.coulomb + wp.abs(m.of_motor * torque - m.of_load * load)
    if m.slow_of_motor + m.slow_of_load > wp.float64(0.0):
        slow = v * m.per_slow
        if slow * slow < _NO_EXPONENT:
            stribeck = wp.abs(m.slow_of_motor * torque - m.slow_of_load * load)
            bound += decay(slow * slow) * stribeck
    return bound


@wp.func
def softness(m: Motor) -> F:
    """Time constant with which dry friction stops the shaft, s; 0 for an immediate stop."""
    return m.stick + m.creep


@wp.func
def soft_stop(v: F, free: F, h: F, m: Motor) -> F:
    """Speed after h, with friction below its bound; ``free`` is the speed without friction."""
    creeping = m.creep * (free - v) / h
    return creeping + (v - creeping) * decay(h / softness(m))


@wp.func
def pd_torque(kp: F, kd: F, error: F, v: F) -> F:
    """Torque of the servo, T = kp (J_des - J) - kd J'. Lin, Liu, Wang (2024), Sec. III-B.2."""
    return kp * error - kd * v


@wp.func
def pendulum_torque(q: F, gravity: F) -> F:
    """Torque of the stated load's weight."""
    if gravity == wp.float64(0.0):
        return wp.float64(0.0)
    return -gravity * sine(q)


@wp.func
def slide(state: wp.vec4d, free: F, stop: F, half: F, torque: F, per_h: F) -> wp.vec4d:
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
def free_mass(q: F, v: F, torque: F, damping: F, inertia: F, dry: F, h: F) -> wp.vec2d:
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
