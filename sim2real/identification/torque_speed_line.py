"""The torque-speed line of a linear servo's motor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.fit import best_of, errors, first_guess
from sim2real.identification.motor_fit import EXPLAINED, fit_motor
from sim2real.identification.motor_prior import motor_prior
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import COLUMNS, LINE, stated
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace, sensor_noise

_LINE = [COLUMNS.index(name) for name in LINE]
_LARGER = np.linspace(1.0, 2.0, 26)
_LARGEST_COST = 2.0
"""Log-likelihood that a line may cost, about the effect of chance on one parameter."""


def on_its_line(
    traces: Sequence[Trace], servo: Servo, rng: np.random.Generator, *, room: float
) -> tuple[JointModel, float] | None:
    """The servo with its motor's line, and its residual relative to that of the linear servo.

    None if the linear servo explains the recordings.

    Args:
        traces: Recordings of one joint.
        servo: Its data sheet.
        rng: Generator for the search for a starting point.
        room: Largest factor between the fitted line and the data sheet's.
    """
    noise = sensor_noise(traces)
    start, others = first_guess(traces, rng)
    plain, _ = best_of(traces, [start, *others])
    if rms(plain.residuals) < EXPLAINED * noise:
        return None
    prior = motor_prior(servo, traces)
    parameters = list(prior.parameters)
    for name in LINE:
        k = prior.index(name)
        middle = float(np.exp(parameters[k].nominal))
        if np.isclose(middle, servo.max_torque_Nm) or name != LINE[0]:
            parameters[k] = replace(parameters[k], low=middle / room, high=middle * room)
    motor = fit_motor(traces, plain, replace(prior, parameters=tuple(parameters)), LINE, rng)
    model = stated(motor.fit.row, traces[0].load)
    return model, rms(motor.fit.residuals) / rms(plain.residuals)


def with_stated_line(traces: Sequence[Trace], servo: Servo, row: Array) -> Array:
    """A servo's parameters (P,) with its data sheet's line, if the recordings do not determine it.

    Without a line, faster motions would be predicted with unlimited torque. If the recordings
    exclude the stated torque, the smallest larger one that they allow is used, up to twice the
    stated one, otherwise no line; likewise if the load is unknown. A line is excluded if it costs
    more than ``_LARGEST_COST`` of log-likelihood.
    """
    if row[_LINE].any() or traces[0].load is PER_INERTIA:
        return row
    rows = np.tile(row, (1 + _LARGER.size, 1))
    rows[1:, _LINE[0]] = servo.max_torque_Nm * _LARGER
    rows[1:, _LINE[1]] = servo.no_load_speed_rad_s
    residuals = np.concatenate(errors(Simulator(traces), rows), axis=1)
    squares = np.sum(residuals**2, axis=1)
    allowed = 0.5 * residuals.shape[1] * np.log(squares[1:] / squares[0]) < _LARGEST_COST
    return np.asarray(rows[1 + np.argmax(allowed)] if allowed.any() else row)
