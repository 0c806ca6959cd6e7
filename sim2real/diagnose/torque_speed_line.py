"""The motor's limit of torque, as the data sheet states it, of joints whose model has none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.baseline import with_effects
from sim2real.diagnose.case import Case, JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.identification.first_guess import first_guess
from sim2real.identification.motor_choice import EXPLAINED, fit_limit, without_flat_limit
from sim2real.identification.plain_fit import best_of
from sim2real.identification.priors import motor_prior
from sim2real.identification.problem import ServoProblem
from sim2real.identification.servo_problem import (
    FLAT_COLUMNS,
    LINE_COLUMNS,
    SATURATION,
    Fits,
    Hypothesis,
    Set,
    minimise,
    plain_servos,
)
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Law, Model
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import BASE, LINE, stated
from sim2real.servo.trace import Trace, sensor_noise, traces

_LARGER = np.linspace(1.0, 2.0, 26)


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
        # A smaller change of the error is irrelevant.
        if line is not None and line[1] < 1 - DECISION.negligible:
            lines[joint.name] = line[0]
    if not lines:
        return case
    return replace(case, model=replace(case.model or Model(joints={}), joints=known | lines))


def _on_its_line(
    traces: Sequence[Trace], servo: Servo, rng: np.random.Generator
) -> tuple[JointModel, float] | None:
    """The servo with its motor's line, and its residual relative to that of the linear servo."""
    noise = sensor_noise(traces)
    start, others = first_guess(traces, rng)
    plain = best_of(traces, np.vstack([start[None], others]))
    if rms([plain.error]) < EXPLAINED * noise:
        return None
    prior, room = motor_prior(servo, traces), 1 / DECISION.data_sheet_share
    for name in LINE:
        middle = float(np.exp(prior[name].nominal))
        if np.isclose(middle, servo.max_torque_Nm) or name != LINE[0]:
            prior = prior.changed(name, low=middle / room, high=middle * room)
    names = (*BASE[:3], *LINE)
    motor = fit_limit(traces, plain, prior, names, rng, noise=noise, current_limits=())
    model = stated(motor.row, traces[0].load, law=motor.law)
    return model, rms([motor.error]) / rms([plain.error])


def models_with_limits(
    batch: Batch, joints: Sequence[JointCase], best: Sequence[Hypothesis]
) -> dict[int, JointModel]:
    """Plain models with their motor's limit, of joints that reach it.

    The limit is a line of torque and speed, or flat: the data sheet's torque at any speed. Anything
    large that is missing hides it from a fit of the plain servo, so it is fitted with ``best``,
    what explains each joint best at first sight.
    """
    models = {}
    for j, (joint, servo) in enumerate(zip(joints, best, strict=True)):
        row = servo.fit.servos.theta[0].copy()
        if joint.references or joint.base or joint.stall_Nm is None or row[LINE_COLUMNS].any():
            continue
        assert joint.servo is not None
        least = DECISION.data_sheet_share * joint.stall_Nm
        # A limit at the data sheet's is the motor's by another name.
        at_sheet = row[FLAT_COLUMNS[0]] > least
        others: Set = servo.members - {SATURATION} if at_sheet else servo.members
        line, flat = row.copy(), row.copy()
        line[LINE_COLUMNS] = joint.stall_Nm, joint.servo.no_load_speed_rad_s
        if at_sheet:
            line[FLAT_COLUMNS] = 0.0
        else:
            flat[FLAT_COLUMNS] = joint.stall_Nm, 1.0
        fits = [_fitted(batch, j, others, line)]
        if SATURATION not in others:
            fits.append(_fitted(batch, j, others | {SATURATION}, flat))
        best_fit = max(fits, key=lambda fit: float(fit.loglikelihood[0]))
        gain = float(best_fit.loglikelihood[0] - servo.fit.loglikelihood[0])
        if gain <= (-1.0 if at_sheet else DECISION.decisive_gain):
            continue
        law: Law = "motor"
        theta = best_fit.servos.theta[0]
        if best_fit is not fits[0]:
            if theta[FLAT_COLUMNS[0]] <= least:
                continue
            theta, law = without_flat_limit(theta), "current_limited"
        models[j] = stated(theta, joint.traces[0].load, law=law)
    return models


def _fitted(batch: Batch, j: int, members: Set, row: Array) -> Fits:
    """The fit of joint ``j`` with these effects, from a row (P,)."""
    inertia = batch.load[batch.first_signal[j], :1]
    plain = plain_servos(np.array([j]), row[None], inertia, batch.period, free_line=True)
    start = with_effects(plain, members, row, float(inertia[0]))
    return minimise(batch, start, iterations=15)


def with_stated_line(
    traces: Sequence[Trace], servo: Servo, row: Array, *, largest_cost: float = 2.0
) -> Array:
    """A servo's parameters (P,) with its data sheet's line, if the recordings do not determine it.

    Without a line, faster motions would be predicted with unlimited torque. If the recordings
    exclude the stated torque, the smallest larger one that they allow is used, up to twice the
    stated one, otherwise no line; likewise if the load is unknown. A line is excluded if it costs
    more than ``largest_cost`` of log-likelihood, about the effect of chance on one parameter.
    """
    if row[LINE_COLUMNS].any() or traces[0].load is PER_INERTIA:
        return row
    rows = np.tile(row, (1 + _LARGER.size, 1))
    rows[1:, LINE_COLUMNS[0]] = servo.max_torque_Nm * _LARGER
    rows[1:, LINE_COLUMNS[1]] = servo.no_load_speed_rad_s
    residuals = ServoProblem(traces, rows[1], ()).row_residuals(rows)
    squares = np.sum(residuals**2, axis=1)
    allowed = 0.5 * residuals.shape[1] * np.log(squares[1:] / squares[0]) < largest_cost
    return np.asarray(rows[1 + np.argmax(allowed)] if allowed.any() else row)
