"""A linear servo on the torque-speed line of its motor, where recordings reach that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.fit import best_of, errors, gains
from sim2real.identification.initial_guess import first_guess
from sim2real.identification.motor_fit import EXPLAINED, fit_motor
from sim2real.identification.motor_prior import MotorPrior, motor_prior
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import COLUMNS, LINE, stated
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace, sensor_noise

Array = NDArray[np.float64]

_LINE = [COLUMNS.index(name) for name in LINE]
_LARGER = np.linspace(1.0, 2.0, 26)


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
    noise = sensor_noise(given)
    start, others = first_guess(given, rng)
    names = [p.name for p in gains(start, given[0].load.inertia_kgm2)]
    plain, _ = best_of(given, [start, *others], names)
    if rms(plain.residuals) < EXPLAINED * noise:
        return None
    motor = fit_motor(given, plain, _near_the_sheet(servo, given, room), LINE, rng)
    model = stated(motor.fit.row, given[0].load)
    return model, rms(motor.fit.residuals) / rms(plain.residuals)


def with_stated_line(
    given: Sequence[Trace], servo: Servo, row: Array, *, largest_cost: float = 2.0
) -> Array:
    """A servo's parameters (P,) with its data sheet's line, which its recordings do not reach.

    What drives harder would else be predicted with a torque that no motor has. Where the recordings
    speak against the stated torque, the next larger one that they allow; no line where none of up
    to twice it, or where the load is unknown. Recordings speak against a line that costs more than
    ``largest_cost`` of log-likelihood: about what a parameter is free to by chance.
    """
    if row[_LINE].any() or given[0].load is PER_INERTIA:
        return row
    rows = np.tile(row, (1 + _LARGER.size, 1))
    rows[1:, _LINE[0]] = servo.max_torque_Nm * _LARGER
    rows[1:, _LINE[1]] = servo.no_load_speed_rad_s
    left = np.concatenate(errors(Simulator(given), rows), axis=1)
    size = np.sum(left**2, axis=1)
    allowed = 0.5 * left.shape[1] * np.log(size[1:] / size[0]) < largest_cost
    return np.asarray(rows[1 + np.argmax(allowed)] if allowed.any() else row)


def _near_the_sheet(servo: Servo, given: Sequence[Trace], room: float) -> MotorPrior:
    prior = motor_prior(servo, given)
    parameters = list(prior.parameters)
    for name in LINE:
        k = prior.index(name)
        middle = float(np.exp(parameters[k].middle))
        if np.isclose(middle, servo.max_torque_Nm) or name != LINE[0]:
            parameters[k] = replace(parameters[k], low=middle / room, high=middle * room)
    return replace(prior, parameters=tuple(parameters))
