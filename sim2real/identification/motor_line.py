"""A linear servo on the torque-speed line of its motor, where recordings reach that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.identification.fit import best_of, gains
from sim2real.identification.motor_fit import EXPLAINED, fit_motor
from sim2real.identification.motor_prior import Prior, motor_prior
from sim2real.identification.start import first_guess
from sim2real.inference.holdout import rms
from sim2real.model import JointModel
from sim2real.noise import noise_floor
from sim2real.robot import Servo
from sim2real.servo.parameters import LINE, stated
from sim2real.servo.trace import Trace


def on_its_line(
    given: Sequence[Trace], servo: Servo, rng: np.random.Generator, *, room: float
) -> tuple[JointModel, float] | None:
    """The servo with its motor's line, and the share of the linear servo's error that it leaves.

    None where the linear servo leaves nothing but noise.

    Args:
        given: Recordings of one joint.
        servo: Its data sheet.
        rng: For the scan for a start.
        room: How many times the data sheet's the line may be, either way.
    """
    noise = max(noise_floor(t.t, t.command, t.position) for t in given)
    start, others = first_guess(given, rng)
    names = [p.name for p in gains(start, given[0].load.inertia_kgm2)]
    plain, _ = best_of(given, [start, *others], names)
    if rms(plain.residuals) < EXPLAINED * noise:
        return None
    motor = fit_motor(given, plain, _near_the_sheet(servo, given, room), LINE, rng)
    model = stated(motor.fit.row, given[0].load)
    return model, rms(motor.fit.residuals) / rms(plain.residuals)


def _near_the_sheet(servo: Servo, given: Sequence[Trace], room: float) -> Prior:
    prior = motor_prior(servo, given)
    beliefs = list(prior.beliefs)
    for name in LINE:
        k = prior.index(name)
        middle = float(np.exp(beliefs[k].middle))
        if np.isclose(middle, servo.max_torque_Nm) or name != LINE[0]:
            beliefs[k] = replace(beliefs[k], low=middle / room, high=middle * room)
    return replace(prior, beliefs=tuple(beliefs))
