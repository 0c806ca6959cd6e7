"""Marching plant and firmware from event to event: ticks, arriving set-points, samples.

Between events every voltage is constant. The mechanics advance by explicit midpoint steps, the
friction bristle exactly along each of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from firmware import TICK_S, advance_integral, advance_target, duty_cycle, shaped_target
from numba import njit
from numpy.typing import NDArray
from plant import (
    EDGE_S,
    Record,
    advance_bristle,
    contact_torque,
    friction_level,
    friction_torque,
    load_torque,
    motor_current,
    motor_torque,
    shaft_torque,
    window_weight,
)

Array = NDArray[np.float64]

SMOOTH_STEP_S = 5e-4
FRICTION_STEP_S = 2.5e-4
CONTACT_STEP_S = 1e-4
BUS_TIME_S = 2e-3  # the supply's capacitor follows its load this fast
DUTY_PEAK, TORQUE_PEAK, SPEED_PEAK, CURRENT_SQUARE = range(4)  # columns of the figures


class Supply(NamedTuple):
    """What the three motors share: relative losses of voltage."""

    sag: float = 0.0  # when one motor takes its stall current
    droop_per_s: float = 0.0


class Motion(NamedTuple):
    """A simulated recording of J joints and T samples.

    Attributes:
        seen: Angle at the recorded sensor before its errors and noise, rad, shape (J, T).
        figures: Per joint the largest |duty cycle| asked for, |torque| in N m and |speed| in rad/s,
            and the mean squared current in A2; shape (J, 4).
    """

    seen: Array
    figures: Array


def simulate(
    joints: Record, supply: Supply, windows: Array, t: Array, arrivals: Array, setpoints: Array
) -> Motion:
    """Move from rest at angle 0.

    Args:
        joints: Parameters, ``plant.JOINT`` of shape (J,).
        supply: Losses of the common supply.
        windows: Times in s between which intermittent physics acts, shape (J, W, 2).
        t: Sample times in s from 0, increasing, shape (T,).
        arrivals: When each set-point takes effect, s, shape (J, K), not decreasing along K.
        setpoints: What then is in force, rad, shape (J, K).
    """
    step = SMOOTH_STEP_S
    rubbing = ("friction_Nm", "stiction_Nm", "load_ratio", "jam_Nm", "stop_Nm_per_rad")
    if any(np.any(joints[name] > 0) for name in rubbing):
        step = FRICTION_STEP_S
    if np.any(joints["contact_Nm_per_rad"] > 0):
        step = CONTACT_STEP_S
    return Motion(*_march(joints, *supply, windows, t, arrivals, setpoints, step))


@njit
def _accelerations(p, duty, bus, time, q, w, ql, wl, bristle, heat, weight, neighbour):
    """Of shaft and load, rad/s2, with the motor's current in A and its torque in N m."""
    if p.off_in_windows > 0.0 and weight > 0.0:
        duty = 0.0  # the unpowered bridge shorts the winding
    current = motor_current(p, duty, bus, w)
    torque = motor_torque(p, current, heat)
    inertia = p.inertia + p.extra_inertia
    if p.contact_Nm_per_rad > 0.0:
        inertia = p.rotor_inertia
    on_shaft = torque + shaft_torque(p, q)
    level = friction_level(p, bristle, w, torque, p.jam_Nm > 0.0 and weight > 0.0)
    on_shaft -= friction_torque(p, bristle, w, level, inertia)
    on_load = load_torque(p, ql, wl, time, weight) + p.reaction_kgm2 * neighbour
    if p.contact_Nm_per_rad == 0.0:
        a = (on_shaft + on_load) / inertia
        return a, a, current, torque
    through = contact_torque(p, q - ql, w - wl)
    load = p.inertia + p.extra_inertia - p.rotor_inertia
    return (on_shaft - through) / inertia, (on_load + through) / load, current, torque


@njit
def _march(joints, sag, droop_per_s, windows, t, arrivals, setpoints, step):
    n, count = joints.size, t.size
    seen, figures = np.zeros((n, count)), np.zeros((n, 4))
    q, w, ql, wl = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    bristle, heat, filtered = np.zeros(n), np.zeros(n), np.zeros(n)
    a, al, current = np.zeros(n), np.zeros(n), np.zeros(n)
    duty, target, target_speed, integral = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    error, last_tick, next_tick = np.zeros(n), np.zeros(n), np.zeros(n)
    setpoint, arrived = setpoints[:, 0].copy(), np.zeros(n, np.int64)
    bus, now = 1.0, t[0]
    next_tick[:] = now
    last_tick[:] = now
    for i in range(count):
        while True:
            for j in range(n):
                if next_tick[j] > now:
                    continue
                p = joints[j]
                dt = now - last_tick[j]
                target[j], target_speed[j] = advance_target(
                    p, target[j], target_speed[j], setpoint[j], dt
                )
                integral[j] = advance_integral(p, integral[j], error[j], dt)
                k = arrived[j]
                while k < arrivals.shape[1] and arrivals[j, k] <= now:
                    setpoint[j] = setpoints[j, k]
                    k += 1
                arrived[j] = k
                error[j] = shaped_target(p, target[j], setpoint[j]) - q[j]
                asked = duty_cycle(p, error[j], w[j], integral[j])
                figures[j, DUTY_PEAK] = max(figures[j, DUTY_PEAK], abs(asked))
                duty[j] = min(max(asked, -1.0), 1.0)
                last_tick[j] = now
                next_tick[j] = now + TICK_S
                if k < arrivals.shape[1]:
                    next_tick[j] = min(next_tick[j], arrivals[j, k])
            if now >= t[i]:
                break
            until = min(t[i], next_tick.min())
            steps = max(1, int(np.ceil((until - now) / step - 1e-6)))
            h = (until - now) / steps
            for m in range(steps):
                time = now + m * h
                for j in range(n):
                    p = joints[j]
                    weight = _weight(p, windows[j], time)
                    neighbour = a[int(p.neighbour)] if p.reaction_kgm2 != 0.0 else 0.0
                    rigid = p.contact_Nm_per_rad == 0.0
                    a1, al1, _, _ = _accelerations(
                        p, duty[j], bus, time, q[j], w[j], ql[j], wl[j], bristle[j], heat[j],
                        weight, neighbour,
                    )  # fmt: skip
                    w_mid, wl_mid = w[j] + 0.5 * h * a1, wl[j] + 0.5 * h * al1
                    q_mid, ql_mid = q[j] + 0.5 * h * w[j], ql[j] + 0.5 * h * wl[j]
                    b_mid = advance_bristle(p, bristle[j], w[j], 0.5 * h)
                    a[j], al[j], current[j], torque = _accelerations(
                        p, duty[j], bus, time + 0.5 * h, q_mid, w_mid, ql_mid, wl_mid, b_mid,
                        heat[j], weight, neighbour,
                    )  # fmt: skip
                    before = ql[j] if p.seen_behind_contact > 0.0 else q[j]
                    q[j] += h * w_mid
                    w[j] += h * a[j]
                    ql[j] = q[j] if rigid else ql[j] + h * wl_mid
                    wl[j] = w[j] if rigid else wl[j] + h * al[j]
                    bristle[j] = advance_bristle(p, bristle[j], w_mid, h)
                    after = ql[j] if p.seen_behind_contact > 0.0 else q[j]
                    if p.sensor_filter_s > 0.0:
                        middle = 0.5 * (before + after)
                        fade = np.exp(-h / p.sensor_filter_s)
                        filtered[j] = middle + (filtered[j] - middle) * fade
                    heating = current[j] ** 2 / p.heat_reference_A2
                    heat[j] += (heating - heat[j]) * h / p.heat_time_s
                    figures[j, TORQUE_PEAK] = max(figures[j, TORQUE_PEAK], abs(torque))
                    figures[j, SPEED_PEAK] = max(figures[j, SPEED_PEAK], abs(w[j]))
                    figures[j, CURRENT_SQUARE] += current[j] ** 2 * h
                taken = 0.0
                for j in range(n):
                    taken += abs(current[j]) * joints[j].ohms / joints[j].volts
                level = 1.0 - droop_per_s * (time + h) - sag * taken
                bus += (level - bus) * h / (BUS_TIME_S + h)
            now = until
        for j in range(n):
            p = joints[j]
            angle = ql[j] if p.seen_behind_contact > 0.0 else q[j]
            if p.sensor_filter_s > 0.0:
                angle = filtered[j]
            seen[j, i] = angle - p.slip_rad if now >= p.slip_time_s else angle
    figures[:, CURRENT_SQUARE] /= t[-1] - t[0]
    return seen, figures


@njit
def _weight(p, windows, time):
    if p.push_Nm != 0.0:
        return window_weight(windows, time, EDGE_S)
    if p.jam_Nm > 0.0 or p.off_in_windows > 0.0:
        return window_weight(windows, time, 0.0)
    return 0.0
