"""The line of each motor, where recordings reach it: what a diagnosis takes for granted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.diagnose.case import Case
from sim2real.diagnose.decision import DECISION
from sim2real.inference.holdout import rms
from sim2real.model import JointModel, Model
from sim2real.noise import noise_floor
from sim2real.robot import Servo
from sim2real.servo.fit import gains
from sim2real.servo.identify import best_of
from sim2real.servo.motor_fit import EXPLAINED, fit_motor
from sim2real.servo.motor_prior import Prior, motor_prior
from sim2real.servo.parameters import LINE
from sim2real.servo.start import first_guess
from sim2real.servo.trace import PER_INERTIA, Trace, traces


def with_motors(cases: Sequence[Case], rng: np.random.Generator) -> list[Case]:
    """The cases, each joint that reaches the line of its data sheet with a model that has it.

    A case with references keeps what it knows, and a joint a given model that is not a plain servo.
    """
    return [case if case.references else _with_lines(case, rng) for case in cases]


def _with_lines(case: Case, rng: np.random.Generator) -> Case:
    known = case.model or Model(joints={})
    found = {}
    for joint in case.robot.joints:
        before = known.joints.get(joint.name)
        if before is not None and (before.law != "pd" or before.effects):
            continue
        given = traces(case.recordings, joint.name)
        model = _on_its_line(given, joint.servo, rng) if given else None
        if model is not None:
            found[joint.name] = model
    return replace(case, model=replace(known, joints={**known.joints, **found})) if found else case


def _on_its_line(given: list[Trace], servo: Servo, rng: np.random.Generator) -> JointModel | None:
    noise = max(noise_floor(t.t, t.command, t.position) for t in given)
    start, others = first_guess(given, rng)
    inertia = given[0].load.inertia_kgm2
    names = [p.name for p in gains(start, inertia)]
    plain, _ = best_of(given, [start, *others], names)
    if rms(plain.residuals) < EXPLAINED * noise:
        return None
    motor = fit_motor(given, plain, _near_the_sheet(servo, given), LINE, rng)
    if rms(motor.fit.residuals) > DECISION.line_clear * rms(plain.residuals):
        return None
    kp, kd, latency = (float(x) for x in motor.fit.row[:3])
    known = given[0].load is not PER_INERTIA
    return JointModel(
        kp,
        kd,
        latency,
        inertia_kgm2=inertia,
        per_inertia=not known,
        law="motor",
        motor=motor.values,
        load=given[0].load if known else None,
    )


def _near_the_sheet(servo: Servo, given: Sequence[Trace]) -> Prior:
    prior, room = motor_prior(servo, given), DECISION.line_room
    beliefs = list(prior.beliefs)
    for name in LINE:
        k = prior.index(name)
        middle = float(np.exp(beliefs[k].middle))
        if np.isclose(middle, servo.max_torque_Nm) or name != LINE[0]:
            beliefs[k] = replace(beliefs[k], low=middle / room, high=middle * room)
    return replace(prior, beliefs=tuple(beliefs))
