"""The torque-speed line of the data sheet, of joints whose model has none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import Case, JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.baseline import with_effects
from sim2real.identification.fit import best_of, errors, first_guess
from sim2real.identification.motor_fit import EXPLAINED, fit_motor
from sim2real.identification.motor_prior import motor_prior
from sim2real.identification.servo_problem import Hypothesis, Set, minimise, plain_servos
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS, LINE, stated
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace, sensor_noise, traces

_SATURATION = "torque_saturation"
_LIMIT = COLUMNS.index("torque_saturation.limit_Nm")
_LINE = [COLUMNS.index(name) for name in LINE]
_LARGER = np.linspace(1.0, 2.0, 26)
_LARGEST_COST = 2.0
"""Log-likelihood that a line may cost, about the effect of chance on one parameter."""


def on_their_lines(case: Case, rng: np.random.Generator) -> Case:
    """The case, each joint that reaches the line of its data sheet with a model that has it.

    One with references keeps what it knows, and a joint a given model that is no plain servo.
    """
    known = dict(case.model.joints) if case.model else {}
    lines = {}
    for joint in case.robot.joints if not case.references else ():
        model, data = known.get(joint.name), traces(case.recordings, joint.name)
        if not data or (model is not None and (model.law != "pd" or model.effects)):
            continue
        line = _on_its_line(data, joint.servo, rng)
        # What changes the error by less, nobody would miss.
        if line is not None and line[1] < 1 - DECISION.negligible:
            lines[joint.name] = line[0]
    if not lines:
        return case
    return replace(case, model=replace(case.model or Model(joints={}), joints=known | lines))


def _on_its_line(
    traces: Sequence[Trace], servo: Servo, rng: np.random.Generator
) -> tuple[JointModel, float] | None:
    """The servo with its motor's line, and its residual relative to that of the linear servo.

    None if the linear servo explains the recordings.

    Args:
        traces: Recordings of one joint.
        servo: Its data sheet.
        rng: Generator for the search for a starting point.
    """
    noise = sensor_noise(traces)
    start, others = first_guess(traces, rng)
    plain, _ = best_of(traces, [start, *others])
    if rms(plain.residuals) < EXPLAINED * noise:
        return None
    prior = motor_prior(servo, traces)
    parameters, room = list(prior.parameters), 1 / DECISION.data_sheet_share
    for name in LINE:
        k = prior.index(name)
        middle = float(np.exp(parameters[k].nominal))
        if np.isclose(middle, servo.max_torque_Nm) or name != LINE[0]:
            parameters[k] = replace(parameters[k], low=middle / room, high=middle * room)
    motor = fit_motor(traces, plain, replace(prior, parameters=tuple(parameters)), LINE, rng)
    model = stated(motor.fit.row, traces[0].load)
    return model, rms(motor.fit.residuals) / rms(plain.residuals)


def lines_beside(
    batch: Batch, joints: Sequence[JointCase], best: Sequence[Hypothesis]
) -> dict[int, JointModel]:
    """Plain models on their lines, of joints that reach them beside what explains them best.

    Something large that is missing hides the line from a fit of the plain servo.

    Args:
        batch: The recordings, joint by joint.
        joints: The joints of the batch.
        best: What explains each best at first sight.
    """
    models = {}
    for j, (joint, servo) in enumerate(zip(joints, best, strict=True)):
        row = servo.fit.servos.theta[0].copy()
        if joint.references or joint.base or joint.stall_Nm is None or row[_LINE].any():
            continue
        assert joint.servo is not None
        row[_LINE] = joint.stall_Nm, joint.servo.no_load_speed_rad_s
        # A limit at the data sheet's is the line by another name.
        named_so = row[_LIMIT] > DECISION.data_sheet_share * joint.stall_Nm
        other: Set = servo.members & {_SATURATION} if named_so else frozenset()
        inertia = batch.load[batch.first_signal[j], :1]
        plain = plain_servos(np.array([j]), row[None], inertia, batch.period, free_line=True)
        start = with_effects(plain, servo.members - other, row, float(inertia[0]))
        fit = minimise(batch, start, iterations=15)
        more = float(fit.loglikelihood[0] - servo.fit.loglikelihood[0])
        if more > (0.0 if other else DECISION.decisive_gain):
            models[j] = stated(fit.servos.theta[0], joint.traces[0].load)
    return models


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
