"""The torque that a plain servo lacks: as a sample of states, and in a motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rival_case import Array, Case
from scipy.signal import savgol_filter

from sim2real.identification.fit import Fit
from sim2real.servo.prediction import predict
from sim2real.servo.trace import Trace

SMOOTHING_S = 0.12
"""Window of the local parabolas that give speed and acceleration."""
STEP_S = 0.002
KEPT = 40
"""Samples at either end that the smoothing spoils, at least."""


@dataclass(frozen=True)
class State:
    """What a term may depend on; arrays of one shape. SI units, angles in rad.

    ``error`` is set-point less angle, ``torque`` the motor's as the plain servo has it, ``wound``
    the integral of the error.
    """

    t: Array
    q: Array
    v: Array
    acceleration: Array
    error: Array
    torque: Array
    wound: Array


Residual = Callable[[State], Array]


def lacking_torque(some: list[Trace], plain: Fit) -> tuple[State, Array]:
    """States of all recordings of a joint and the torque that the plain servo lacks in them."""
    kp, kd, latency = plain.row[:3]
    parts, torques = [], []
    for trace in some:
        step = float(np.median(np.diff(trace.t)))
        even = np.arange(trace.t[0], trace.t[-1], step)
        angle = np.interp(even, trace.t[trace.used], trace.position[trace.used])
        window = 2 * max(int(SMOOTHING_S / step / 2), 2) + 1
        q, v, acceleration = (
            savgol_filter(angle, window, 3, deriv=order, delta=step) for order in range(3)
        )
        around = even[:, None] + step * (np.arange(8) - 3.5) / 8 - latency
        at = np.searchsorted(trace.t, around, side="right") - 1
        target = trace.command[np.maximum(at, 0)].mean(axis=1)
        # Smoothed as the angle is, so that the plain servo's own equation still holds.
        error = savgol_filter(target, window, 3) - q
        torque = kp * error - kd * v
        outer = trace.load.gravity_Nm * np.sin(q)
        lacking = trace.load.inertia_kgm2 * acceleration - torque + outer
        kept = slice(max(window, KEPT), -max(window, KEPT))
        wound = np.cumsum(error) * step
        values = (even - even[0], q, v, acceleration, error, torque, wound)
        parts.append([value[kept] for value in values])
        torques.append(lacking[kept])
    return State(*(np.concatenate(c) for c in zip(*parts, strict=True))), np.concatenate(torques)


def predicted(case: Case, residual: Residual) -> dict[str, Array]:
    """Angles on the wanted commands with ``residual`` N m added.

    The difference that it makes is marched by the midpoint rule and added to the exact motion of
    the plain servos, so that the march's own error cancels.
    """
    wanted, joints = case.wanted, list(case.plain)
    exact = predict(case.model, wanted.t, wanted.commands, wanted.loads)
    kp, kd, latency = np.stack([case.plain[joint].row[:3] for joint in joints], axis=1)
    inertia, gravity = np.array(
        [(wanted.loads[j].inertia_kgm2, wanted.loads[j].gravity_Nm) for j in joints]
    ).T
    commands = np.stack([wanted.commands[joint] for joint in joints], axis=1)
    times = np.arange(wanted.t[0], wanted.t[-1] + STEP_S, STEP_S)
    at = np.searchsorted(wanted.t, times[:, None] - latency, side="right") - 1
    targets = np.take_along_axis(commands, np.maximum(at, 0), axis=0)
    most = 0.5 * kp

    def accelerations(t: float, target: Array, q: Array, v: Array, wound: Array) -> Array:
        """Of the plain servos (row 0) and of those with the residual (row 1)."""
        error = target - q
        torque = kp * error - kd * v
        plain = (torque - gravity * np.sin(q)) / inertia
        time = np.full(len(joints), t)
        state = State(time, q[1], v[1], plain[1], error[1], torque[1], wound)
        plain[1] += np.clip(np.nan_to_num(residual(state)), -most, most) / inertia
        return np.asarray(plain)

    q, v = np.tile(commands[0], (2, 1)), np.zeros((2, len(joints)))
    wound, differences = np.zeros(len(joints)), np.zeros((times.size, len(joints)))
    for k, (t, target) in enumerate(zip(times, targets, strict=True)):
        differences[k] = q[1] - q[0]
        half = v + 0.5 * STEP_S * accelerations(t, target, q, v, wound)
        middle = accelerations(t, target, q + 0.5 * STEP_S * v, half, wound)
        q, v = q + STEP_S * half, v + STEP_S * middle
        q[1] = np.clip(q[1], q[0] - 1.0, q[0] + 1.0)
        wound = wound + STEP_S * (target - q[1])
    return {
        joint: exact[joint] + np.interp(wanted.t, times, differences[:, j])
        for j, joint in enumerate(joints)
    }
