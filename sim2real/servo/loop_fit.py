"""When a sampled controller looks, where recordings show it: a scan over rates and phases.

A set-point waits for the controller's next look, so that steps come early and late by up to a
period. No search by slopes finds that: the error is flat in the period but at the true one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim2real.servo.motor_fit import MotorFit, refitted
from sim2real.servo.parameters import BASE, LOOP

Array = NDArray[np.float64]

RATES_HZ = (100, 120, 125, 150, 160, 200, 240, 250, 300, 1000 / 3, 400, 500, 1000)
"""Rates of controllers."""
_PHASES, _FINE = 8, 8
_BEST, _STEPS = 3, 4
_KP, _KD, _LATENCY = (BASE.index(n) for n in ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"))


def sampled(motor: MotorFit) -> MotorFit:
    """The fit with the sampled loop that explains the recordings best; its gain is not judged.

    From a fit without a loop: what is seen half a period late has taken from the damping, and the
    wait for the next look has added to the latency.

    Args:
        motor: A fit without a loop.
    """
    coarse = np.concatenate(
        [_looped(motor, 1 / hz, np.arange(_PHASES) / _PHASES / hz) for hz in RATES_HZ]
    )
    best = coarse[np.argsort(motor.losses(coarse))[:_BEST]]
    found = refitted(motor, best, _STEPS)[0]
    period, phase = (motor.problem.prior.index(name) for name in LOOP)
    length, at = found.x[period], found.x[phase]
    fine = np.tile(found.x, (2 * _FINE + 1, 1))
    fine[:, phase] = (at + length / _PHASES * np.linspace(-1, 1, 2 * _FINE + 1)) % length
    loss = motor.losses(fine)
    near = fine[np.argsort(loss)[:1]]
    return refitted(motor, near)[0]


def _looped(motor: MotorFit, period_s: float, phases_s: Array) -> Array:
    """Servos as searched with a loop of that period, one a phase, shape (phases, F)."""
    prior = motor.problem.prior
    x = np.tile(motor.x, (phases_s.size, 1))
    x[:, prior.index(LOOP[0])] = period_s
    x[:, prior.index(LOOP[1])] = phases_s
    x[:, _LATENCY] = np.maximum(x[:, _LATENCY] - 0.5 * period_s, 0.0)
    x[:, _KD] = np.log(np.exp(x[:, _KD]) + 0.5 * period_s * np.exp(x[:, _KP]))
    return x
