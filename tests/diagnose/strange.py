"""A servo with a torque on its shaft that is in no catalogue."""

import numpy as np
from simulated import INERTIA, KD, KP, LATENCY, NOISE, PERIOD, one_joint, steps

FINE = 20


def strange(seed, name, torque, seconds=12.0):
    """Recording of a servo that ``torque(q, q_dot, t)`` in N m acts on as well."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(round(seconds / PERIOD))
    sent = steps(t, rng)
    q, speed, angle, h = 0.0, 0.0, np.empty(t.size), PERIOD / FINE
    for k in range(t.size):
        angle[k] = q
        for i in range(FINE):
            now = t[k] + i * h
            seen = sent[max(int(np.floor((now - LATENCY) / PERIOD + 1e-9)), 0)]
            speed += h * (KP * (seen - q) - KD * speed + torque(q, speed, now)) / INERTIA
            q += h * speed
    return one_joint(t, sent, angle + rng.normal(0, NOISE, t.size), name=name)


def position_damping(q, speed, t):
    """More damping the further out, in no catalogue."""
    return -0.15 * q**2 * speed
