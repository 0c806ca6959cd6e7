"""Against references: the question is what has changed since, not what a servo lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from sim2real.diagnose.baseline import BLOCKS, with_effects
from sim2real.diagnose.case import Case, JointCase, prepared
from sim2real.diagnose.change import what_changed
from sim2real.diagnose.decision import DECISION, LOG_PRIOR
from sim2real.diagnose.explained import way_of
from sim2real.diagnose.investigate import ROUNDING, Finding
from sim2real.diagnose.result import Experiment
from sim2real.identification.first_guess import first_guess
from sim2real.identification.motor_choice import choose_motor
from sim2real.identification.plain_fit import best_of
from sim2real.identification.servo_problem import Hypothesis, minimise
from sim2real.model import JointModel, Model
from sim2real.robot import Servo
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import joint_row, stated
from sim2real.servo.trace import Trace, sensor_noise, traces


def with_known_servos(case: Case, rng: np.random.Generator) -> Case:
    """The case, its model the law of the servos that made its references where none is given.

    Raises:
        InputError: If references and robot do not agree, or no joint moves in them.
    """
    if not case.references:
        return case
    prepared(replace(case, recordings=case.references, references=()))
    if case.model is not None:
        return case
    joints = {}
    for joint in case.robot.joints:
        references = traces(case.references, joint.name)
        now = traces(case.recordings, joint.name)
        if references and now:
            joints[joint.name] = law_of(references, now, joint.servo, rng)
    return replace(case, model=Model(joints=joints))


def law_of(
    references: list[Trace], case: Sequence[Trace], servo: Servo, rng: np.random.Generator
) -> JointModel:
    """The law of the servo that made the references.

    The motor's, where what it leaves decides; the linear one where repeats or rests explain more.
    """
    load = references[0].load
    start, others = first_guess(references, rng)
    servo_fit = best_of(references, np.vstack([start[None], others]))
    if way_of(references, case) == "law":
        noise = sensor_noise(references)
        motor = choose_motor(references, servo_fit, servo, noise, rng)
        return stated(motor.row, load, motor.effects, motor.law)
    return stated(servo_fit.row, load)


def against_references(batch: Batch, joint: JointCase, finding: Finding) -> Finding:
    """The finding in which only what differs from the joint's references, if any, is named."""
    references = joint.references
    if not references or joint.model is None or joint.servo is None:
        return finding
    row = joint_row(joint.model, references[0].load, joint.name)
    change = what_changed(references, joint.traces, row, joint.servo, joint.step_rad or 0.0)
    tried, plain = finding.tried, finding.tried.plain.fit.servos
    named = [group for group in change.groups if group.probability >= DECISION.named]
    link = change.link.effect if change.link is not None else ""
    enriched = tried.base | {group.members[0] for group in named} - {link}
    if enriched != tried.base:
        # As fitted with the servo of the references: the case alone determines its servo less well.
        servos = with_effects(plain, enriched, change.row, references[0].load.inertia_kgm2)
        servos = replace(servos, theta=change.row[None])
        fit = minimise(batch, servos, iterations=1, blocks=BLOCKS)
        tried.tried[enriched] = Hypothesis(enriched, fit, float(fit.loglikelihood[0]))
    coarser = _coarser(joint)
    coarse = tuple(
        replace(g, probability=min(g.probability, coarser))
        for g in finding.groups
        if g.members == (ROUNDING,) and coarser >= DECISION.named
    )
    nameless = change.nameless > DECISION.named
    return replace(
        finding,
        mismatch=bool(named or nameless or coarse),
        best=tried.tried.get(enriched, tried.plain),
        posterior=change.posterior(tried.base),
        groups=(*coarse, *change.groups),
        unexplained=nameless,
        unknown=change.nameless,
        unmodelled=replace(finding.unmodelled, windows=change.windows),
        link=change.link,
        place=0,
    )


def _coarser(joint: JointCase) -> float:
    """Probability that a joint's sensor is coarser than the references', and that is no chance."""
    grid = max(trace.quantization_step() for trace in joint.references)
    if joint.step_rad is None or joint.step_rad <= DECISION.coarse_step_ratio * grid:
        return 0.0
    levels = [np.unique(np.round(t.position[t.used] / joint.step_rad)) for t in joint.traces]
    gaps = sum(max(values.size - 1, 0) for values in levels)
    return float(expit(gaps * np.log(joint.step_rad / max(grid, 1e-12)) + LOG_PRIOR))


def repeat(joints: Sequence[JointCase]) -> Experiment | None:
    """The command to send again, where it would tell more than the references can: the case's own.

    A recording of the same command as before knows of no missing physics that is in both.
    """
    for joint in joints:
        if joint.references and way_of(joint.references, joint.traces) == "law":
            trace = max(joint.traces, key=Trace.activity)
            return Experiment(
                component=joint.name,
                separates=(),
                command=f"the command of {trace.name}",
                context="none",
                separation=0.0,
                duration_s=trace.duration_s,
                statement=f"Repeat the command of {trace.name} on {joint.name} in the state of the "
                "references: the error of the model is the same in a repeated recording, so far "
                "smaller changes are detected.",
                t=trace.t - trace.t[0],
                signal=trace.command,
            )
    return None
