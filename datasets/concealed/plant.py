"""The plant: a DC motor, its gear train and the load on the output shaft.

All angles and torques are those of the output shaft. Sources of the laws: motor and back-EMF,
Fitzgerald, Kingsley & Umans, "Electric Machinery"; friction, Dahl (1976) and Bliman & Sorine
(1995), with the Stribeck curve of Armstrong-Hélouvry (1991); gear play as an elastic contact with a
dead zone, Nordin, Galic & Gutman (1997).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Record = NDArray[Any]  # one element or an array of the structured types below

# Each field with the value at which it does nothing. Units: SI, angles in rad.
NEUTRAL: dict[str, float] = {
    # motor and gear train
    "volts": 1.0,
    "ohms": 1.0,
    "torque_constant": 0.0,  # N m / A at the motor; the same number in V s / rad
    "gear_ratio": 1.0,
    "rotor_inertia": 0.0,  # reflected to the output shaft
    # load as stated
    "inertia": 1.0,  # everything on the shaft, rotor included
    "pendulum_Nm": 0.0,
    # firmware
    "gain_per_rad": 0.0,  # duty cycle per rad of error
    "damping_s": 0.0,  # duty cycle per rad/s
    "latency_s": 0.0,
    # nuisances of every servo
    "ripple_Nm": 0.0,
    "ripple_per_rad": 0.0,
    "ripple_phase": 0.0,
    "tooth_error_rad": 0.0,
    "teeth_per_rad": 0.0,
    "tooth_phase": 0.0,
    # friction
    "friction_Nm": 0.0,
    "stiction_Nm": 0.0,  # what breakaway adds to it
    "stribeck_rad_s": 1.0,
    "friction_asymmetry": 0.0,
    "load_ratio": 0.0,
    "bristle_rad": 2.5e-4,  # travel over which friction builds up
    "drag_Nms2": 0.0,
    # torque of the motor
    "limit_Nm": np.inf,
    "asymmetry": 0.0,
    "heat_loss": 0.0,
    "heat_reference_A2": 1.0,
    "heat_time_s": 30.0,
    # shaft and load
    "contact_Nm_per_rad": 0.0,  # 0: shaft and load are one body
    "contact_Nms_per_rad": 0.0,
    "gap_rad": 0.0,
    "seen_behind_contact": 0.0,  # 1: the recorded sensor sits on the load
    "extra_inertia": 0.0,
    "gravity_Nm": 0.0,
    "cogging_Nm": 0.0,
    "cogging_period_rad": 1.0,
    "cogging_phase": 0.0,
    # firmware beyond the PD law
    "deadband_rad": 0.0,
    "rate_rad_s": np.inf,
    "acceleration_rad_s2": np.inf,
    "filter_s": 0.0,
    "integral_per_rad_s": 0.0,  # duty cycle per rad s
    "schedule_rad": np.inf,  # error beyond which the gain is another
    "schedule_factor": 1.0,
    # sensor: the recording only
    "sensor_filter_s": 0.0,
    # outside the catalogue
    "slip_rad": 0.0,
    "slip_time_s": np.inf,
    "off_in_windows": 0.0,
    "jam_Nm": 0.0,
    "push_Nm": 0.0,
    "shake_Nm": 0.0,
    "shake_Hz": 0.0,
    "shake_phase": 0.0,
    "stop_rad": np.inf,
    "stop_side": 1.0,
    "stop_Nm_per_rad": 0.0,
    "neighbour": 0.0,  # index of the joint whose acceleration acts on this one
    "reaction_kgm2": 0.0,
}
JOINT = np.dtype([(name, np.float64) for name in NEUTRAL])
EDGE_S = 0.12  # of a push: how long it takes to build up


def neutral_joints(count: int) -> Record:
    """``count`` joints in which nothing is hidden; fields as in ``NEUTRAL``."""
    joints = np.zeros(count, dtype=JOINT)
    for name, value in NEUTRAL.items():
        joints[name] = value
    return joints


@njit
def motor_current(p, duty, bus, speed):
    """Current in A at shaft ``speed``; the winding's inductance is neglected.

    ``bus`` is the supply voltage as a share of the nominal one. A current limit is where the
    firmware's torque limit acts.
    """
    wound = p.gear_ratio * p.torque_constant
    current = (duty * bus * p.volts - wound * speed) / p.ohms
    most = p.limit_Nm / wound
    return min(max(current, -most), most)


@njit
def motor_torque(p, current, heat):
    """Torque in N m on the output shaft, as the winding's temperature and the brushes allow.

    ``heat`` is the rise of temperature, 1 in the steady state under the reference current; the
    loss of torque grows with it towards ``heat_loss``.
    """
    torque = p.gear_ratio * p.torque_constant * current
    if p.heat_loss > 0.0:
        torque *= 1.0 - p.heat_loss * (1.0 - np.exp(-heat))
    return torque * (1.0 + 0.5 * p.asymmetry * np.sign(torque))


@njit
def friction_level(p, bristle, speed, torque, jammed):
    """Friction torque in N m while sliding; ``bristle`` (-1 to 1) says in which direction."""
    level = p.friction_Nm
    if p.stiction_Nm > 0.0:
        level += p.stiction_Nm * np.exp(-((speed / p.stribeck_rad_s) ** 2))
    level *= 1.0 + p.friction_asymmetry * np.sign(bristle)
    level += p.load_ratio * abs(torque)
    if jammed:
        level += p.jam_Nm
    return level


@njit
def friction_torque(p, bristle, speed, level, inertia):
    """Dahl's bristle with enough damping that it doesn't ring while it sticks."""
    if level <= 0.0:
        return 0.0
    damping = np.sqrt(level / p.bristle_rad * inertia)
    return level * bristle + damping * (speed - abs(speed) * bristle)


@njit
def advance_bristle(p, bristle, speed, h):
    """The bristle b after ``h`` s at constant speed v, exactly: db/dt = (v - |v| b) / travel."""
    if speed == 0.0:
        return bristle
    end = 1.0 if speed > 0.0 else -1.0
    return end + (bristle - end) * np.exp(-abs(speed) * h / p.bristle_rad)


@njit
def contact_torque(p, twist, twist_speed):
    """Torque in N m from shaft to load through an elastic contact with play; it can't pull."""
    half = 0.5 * p.gap_rad
    if half == 0.0:
        return p.contact_Nm_per_rad * twist + p.contact_Nms_per_rad * twist_speed
    if twist > half:
        torque = p.contact_Nm_per_rad * (twist - half) + p.contact_Nms_per_rad * twist_speed
        return max(torque, 0.0)
    if twist < -half:
        torque = p.contact_Nm_per_rad * (twist + half) + p.contact_Nms_per_rad * twist_speed
        return min(torque, 0.0)
    return 0.0


@njit
def shaft_torque(p, angle):
    """What depends on the angle of the gear train: its ripple and cogging, N m."""
    torque = p.ripple_Nm * np.sin(p.ripple_per_rad * angle + p.ripple_phase)
    if p.cogging_Nm != 0.0:
        turn = 2.0 * np.pi * angle / p.cogging_period_rad
        torque += p.cogging_Nm * np.sin(turn + p.cogging_phase)
    return torque


@njit
def load_torque(p, angle, speed, time, push):
    """What acts on the load, N m: weights, drag, an end stop, vibration and pushes."""
    hanging = angle - p.slip_rad if time >= p.slip_time_s else angle
    torque = -(p.pendulum_Nm + p.gravity_Nm) * np.sin(hanging)
    torque -= p.drag_Nms2 * speed * abs(speed)
    beyond = p.stop_side * hanging - p.stop_rad
    if beyond > 0.0:
        torque -= p.stop_side * p.stop_Nm_per_rad * beyond
    if p.shake_Nm != 0.0:
        torque += p.shake_Nm * np.sin(2.0 * np.pi * p.shake_Hz * time + p.shake_phase)
    return torque + p.push_Nm * push


@njit
def window_weight(windows, time, edge_s):
    """1 inside a window (W, 2), 0 outside, with raised-cosine edges of ``edge_s`` inside it."""
    for i in range(windows.shape[0]):
        start, stop = windows[i, 0], windows[i, 1]
        if start <= time < stop:
            if edge_s == 0.0:
                return 1.0
            nearest = min(time - start, stop - time)
            if nearest >= edge_s:
                return 1.0
            return 0.5 - 0.5 * np.cos(np.pi * nearest / edge_s)
    return 0.0
