"""The servo's law by the classical Runge-Kutta method, apart from the library."""

import numpy as np
from scipy.optimize import newton

STEP_S = 0.002
"""The longest step: the phase of the tests' servos turns by at most 0.13 rad in it."""


def simulate(parameters, load, t, command):
    """Angles in rad, shape (T,), of a servo from rest on its first set-point.

    ``parameters`` are kp, kd and latency. A step ends at each sample, at each arrival of a
    set-point, and after ``STEP_S``. Source: Lin, Liu, Wang (2024), Sec. III-B.2.
    """
    kp, kd, latency = parameters
    arrival = t + latency
    ends = np.unique(np.concatenate([t, arrival, np.arange(t[0], t[-1], STEP_S)]))
    ends = ends[ends <= t[-1]]
    sent = command[np.maximum(np.searchsorted(arrival, ends, side="right") - 1, 0)]

    def slope(state, u):
        angle, speed = state
        torque = kp * (u - angle) - kd * speed - load.gravity_Nm * np.sin(angle)
        return np.array([speed, torque / load.inertia_kgm2])

    rest = newton(lambda q: kp * (command[0] - q) - load.gravity_Nm * np.sin(q), command[0])
    states = [np.array([rest, 0.0])]
    for h, u in zip(np.diff(ends), sent[:-1], strict=True):
        state = states[-1]
        k1 = slope(state, u)
        k2 = slope(state + h / 2 * k1, u)
        k3 = slope(state + h / 2 * k2, u)
        k4 = slope(state + h * k3, u)
        states.append(state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(states)[np.searchsorted(ends, t), 0]


def slopes(parameters, load, t, command):
    """Derivatives of the angles by each parameter, shape (T, 3), by central differences."""
    steps = np.diag(1e-4 * np.array(parameters))
    up, down = (
        np.array([simulate(parameters + sign * step, load, t, command) for step in steps])
        for sign in (1, -1)
    )
    return (up - down).T / (2 * steps.diagonal())
