"""The servo as it is built: a drive that clips, a motor on its torque-speed line, gears that rub.

With T = kp e - kd v the torque that the linear servo would make, K the stall torque, w the no-load
speed and b = K / w the back-EMF's damping::

    drive   d = clip(T + b v, -K, K)                           what the bridge can give
    motor   m (1 + r |m| / K) = d - b v                        r: rise of resistance with current
    dry     Kc + |Km m - Ke l| + exp(-(v / vs)^2) |Ksm m - Kse l|

where l is the weight of the load. Damping that the line has not (kd > b) is the controller's, so
that the drive of a servo with a proportional controller alone, kd = b, is clip(kp e). Without a
limit, loss and friction this is the linear servo. The controller may see angle and speed once a
period only, from its phase on, and hold its drive in between; back-EMF it cannot hold.

Dry friction stops the shaft at once, or softly: while it is below its bound it lets the speed v
settle, under a torque T that would accelerate the free shaft by a, at what creeps on::

    v' = (tc a - v) / (ts + tc)                                ts: sticking, tc: creeping

so that ts = tc = 0 is Coulomb's, ts = 0 friction that is viscous near standstill.

Sources: the circuit of a DC motor behind a bridge (any text on motors); friction: Duclusaud,
Passault, Padois, Ly, Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA
2025, whose directional model with a Stribeck part this is (the exponent 2 as in
``effects.stribeck_friction``). Soft sticking: MuJoCo's documentation, Computation, Constraint model
(friction loss; impedance d and rate b give ts = 1 / b and tc = ts (1 - d) / d, 9.5 and 1.06 ms by
default).

Symbols and units as in ``law``; ``p`` is the joint's row of parameters.
"""

import warp as wp

from sim2real.effects import MOST_EFFECTS
from sim2real.servo.parameters import FIRST_MOTOR_COLUMN, MOTOR

Row = wp.array(dtype=wp.float64)

MOTOR_BIT = -(1 << MOST_EFFECTS)
"""Bit of the mask of active effects that is set where the law is not the linear one."""


def _column(name: str) -> int:
    return FIRST_MOTOR_COLUMN + MOTOR.index(f"motor.{name}")


_STALL = wp.constant(_column("stall_torque_Nm"))
_NO_LOAD = wp.constant(_column("no_load_speed_rad_s"))
_RISE = wp.constant(_column("resistance_rise"))
_ROTOR = wp.constant(_column("rotor_inertia_kgm2"))
_COULOMB = wp.constant(_column("coulomb_Nm"))
_OF_MOTOR = wp.constant(_column("motor_friction"))
_OF_LOAD = wp.constant(_column("load_friction"))
_SLOW_OF_MOTOR = wp.constant(_column("stribeck_motor_friction"))
_SLOW_OF_LOAD = wp.constant(_column("stribeck_load_friction"))
_SLOW = wp.constant(_column("stribeck_speed_rad_s"))
_STICK = wp.constant(_column("stick_time_s"))
_CREEP = wp.constant(_column("creep_time_s"))
_PERIOD = wp.constant(_column("loop_period_s"))
_PHASE = wp.constant(_column("loop_phase_s"))


@wp.struct
class Push:
    """What the motor gives during a sub-step: ``torque - damping * speed``.

    ``stiffness`` is the derivative of ``torque`` by the error, 0 where the drive clips.
    """

    torque: wp.float64
    damping: wp.float64
    stiffness: wp.float64


@wp.func
def rotor_inertia(p: Row) -> wp.float64:
    """Inertia of rotor and gears on the shaft, kg m2."""
    return p[_ROTOR]


@wp.func
def loop_period(p: Row) -> wp.float64:
    """Period of the controller in s, 0 for one that never sleeps."""
    return p[_PERIOD]


@wp.func
def loop_phase(p: Row) -> wp.float64:
    """Its first look after the start, s."""
    return p[_PHASE]


@wp.func
def softness(p: Row) -> wp.float64:
    """Time in which dry friction stops the shaft, s; 0 where at once."""
    return p[_STICK] + p[_CREEP]


@wp.func
def back_emf(kd: wp.float64, p: Row) -> wp.float64:
    """Damping b of the torque-speed line, N m s; ``kd`` where no line is known."""
    if p[_STALL] > wp.float64(0.0) and p[_NO_LOAD] > wp.float64(0.0):
        return p[_STALL] / p[_NO_LOAD]
    return kd


@wp.func
def wanted_drive(
    kp: wp.float64, kd: wp.float64, error: wp.float64, v: wp.float64, p: Row
) -> wp.float64:
    """Drive that the controller asks for, before it clips, N m at stall."""
    return kp * error - (kd - back_emf(kd, p)) * v


@wp.func
def motor_push(
    kp: wp.float64, kd: wp.float64, error: wp.float64, v: wp.float64, free: wp.float64, p: Row
) -> Push:
    """Torque and damping of the motor, the shaft now at speed ``v``.

    ``free`` is the speed that the linear servo would have in the middle of the sub-step.
    """
    push = Push()
    push.torque = kp * error
    push.damping = kd
    push.stiffness = kp
    limit = p[_STALL]
    if limit > wp.float64(0.0) and wp.abs(wanted_drive(kp, kd, error, free, p)) > limit:
        push.torque = wp.clamp(wanted_drive(kp, kd, error, free, p), -limit, limit)
        push.damping = back_emf(kd, p)
        push.stiffness = wp.float64(0.0)
    return weakened(push, v, p)


@wp.func
def held_push(drive: wp.float64, kd: wp.float64, v: wp.float64, p: Row) -> Push:
    """The same for a drive that the controller holds."""
    push = Push()
    push.torque = drive
    if p[_STALL] > wp.float64(0.0):
        push.torque = wp.clamp(drive, -p[_STALL], p[_STALL])
    push.damping = back_emf(kd, p)
    return weakened(push, v, p)


@wp.func
def weakened(push: Push, v: wp.float64, p: Row) -> Push:
    """What is left of it as the motor's resistance rises with its current."""
    if p[_RISE] > wp.float64(0.0) and p[_STALL] > wp.float64(0.0):
        size = wp.abs(push.torque - push.damping * v) / p[_STALL]
        root = wp.sqrt(wp.float64(1.0) + wp.float64(4.0) * p[_RISE] * size)
        left = wp.float64(2.0) / (wp.float64(1.0) + root)
        push.torque *= left
        push.damping *= left
        push.stiffness *= left
    return push


@wp.func
def gear_friction(v: wp.float64, torque: wp.float64, load: wp.float64, p: Row) -> wp.float64:
    """Largest torque of dry friction in bearings and gears, N m."""
    bound = p[_COULOMB] + wp.abs(p[_OF_MOTOR] * torque - p[_OF_LOAD] * load)
    if p[_SLOW_OF_MOTOR] > wp.float64(0.0) or p[_SLOW_OF_LOAD] > wp.float64(0.0):
        slow = v / wp.max(p[_SLOW], wp.float64(1e-12))
        more = wp.abs(p[_SLOW_OF_MOTOR] * torque - p[_SLOW_OF_LOAD] * load)
        bound += wp.exp(-slow * slow) * more
    return bound


@wp.func
def soft_stop(v: wp.float64, free: wp.float64, h: wp.float64, p: Row) -> wp.float64:
    """Speed after h, friction below its bound, of a shaft at ``v`` that would reach ``free``."""
    creeping = p[_CREEP] * (free - v) / h
    return creeping + (v - creeping) * wp.exp(-h / softness(p))
