"""What a report shows besides the findings: figures, errors, limits, the next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import Case
from sim2real.diagnose.changed.references import repeat
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.missing.open_sets import rival_sets, set_probabilities
from sim2real.diagnose.missing.screening import Candidate, Screen
from sim2real.diagnose.missing.unmodelled import simulated_angle
from sim2real.diagnose.result import DetectionLimit, Diagnosis, JointSeries, Ladder, to_design
from sim2real.diagnose.rival_sets import design_of
from sim2real.diagnose.separation import separations
from sim2real.findings import all_findings
from sim2real.inference.normal import NINE_IN_TEN
from sim2real.servo.linearised import residual_torque, smooth_speed


def with_checks(found: Diagnosis, case: Case, joints: Sequence[JointFindings]) -> Diagnosis:
    """The diagnosis of one robot with all that its report shows.

    Args:
        found: The diagnosis.
        case: The robot.
        joints: What is known of its joints.
    """
    checks = (
        f"{recording.name}: {finding.text}"
        for recording in case.recordings
        for finding in all_findings(recording, case.robot)
    )
    return replace(
        found,
        gate=tuple(dict.fromkeys(checks)),
        warnings=case.warnings,
        evidence=tuple(series for joint in joints for series in _evidence(joint)),
        detection_limits=tuple(limit for joint in joints for limit in _limits(joint)),
        ladders={joint.signal: x for joint in joints if (x := _ladder(joint)) is not None},
        separations=tuple(
            separation
            for joint in joints
            if (stated := design_of(case.recordings, joint.name))
            for separation in separations(joint.name, stated, set_probabilities(joint))
        ),
        rival_sets=tuple(
            rival_sets(joint.joint, joint.finding)
            for joint in joints
            if joint.finding.mismatch and not joint.joint.references
        ),
        next_experiment=repeat([j.joint for j in joints])
        or to_design(
            (effect.component, effect.group) for effect in found.effects if not case.references
        ),
    )


def _limits(joint: JointFindings) -> list[DetectionLimit]:
    tried, members = joint.finding.tried, joint.enriched.members
    known = members if members in tried.tried else tried.base
    return detection_limits(*joint.finding.search.seen(tried, known), joint.name)


def _ladder(joint: JointFindings) -> Ladder | None:
    """Held-out errors of ever better informed predictors; None where nothing is held out."""
    before, after = (joint.fit(enriched=enriched)["heldout"] for enriched in (False, True))
    if before is None or after is None:
        return None
    return Ladder(baseline=before, enriched=after, noise=joint.joint.noise)


def _evidence(joint: JointFindings) -> list[JointSeries]:
    kp, kd = (float(x) for x in joint.finding.tried.plain.fit.servos.theta[0, :2])
    series = []
    for trace, before, after in zip(joint.joint.traces, joint.before, joint.after, strict=False):
        plain, with_effects = (simulated_angle(residual, trace) for residual in (before, after))
        position = trace.measured
        servo = (trace.load.inertia_kgm2, kd, kp + trace.load.gravity_Nm)
        error = np.where(trace.used, plain - position, np.nan)
        torque, sd = residual_torque(trace.t, error, servo, joint.joint.noise)
        effects_torque, _ = residual_torque(trace.t, plain - with_effects, servo, joint.joint.noise)
        series.append(
            JointSeries(
                joint=joint.name,
                recording=trace.name,
                t=trace.t,
                command=trace.command,
                position=position,
                baseline=plain,
                enriched=with_effects,
                speed=smooth_speed(trace.t, position),
                torque=torque,
                torque_sd=sd,
                effects_torque=effects_torque,
            )
        )
    return series


def detection_limits(
    seen: Screen, candidates: Sequence[Candidate], component: str
) -> list[DetectionLimit]:
    """The smallest strength of each effect that could be noticed.

    The score of an effect grows with its strength; between the strengths that were simulated it is
    interpolated, both on logarithmic scales.

    Args:
        seen: What every start of every candidate would leave in the innovations.
        candidates: The candidates, as the screen counts them.
        component: The joint.
    """
    needed = float(np.sqrt(2 * DECISION.detection_gain)) + NINE_IN_TEN
    limits = []
    for k, option in enumerate(candidates):
        mine = seen.candidate == k
        strength = np.abs(option.starts[seen.start[mine], 0])
        smallest = _crossing(strength, seen.visible[mine], needed)
        effect = option.effect
        limits.append(DetectionLimit(effect.name, component, {effect.parameters[0].name: smallest}))
    return limits


def _crossing(strength: Array, visible: Array, needed: float) -> float | None:
    """Strength at which the score reaches what is needed; None where no start does."""
    levels = np.unique(strength)
    score = np.array([np.median(visible[strength == level]) for level in levels])
    enough = np.flatnonzero(score >= needed)
    if not enough.size:
        return None
    weaker_is_larger = score[0] > score[-1]
    at = int(enough[-1] if weaker_is_larger else enough[0])
    beyond = at + 1 if weaker_is_larger else at - 1
    if not 0 <= beyond < levels.size or score[beyond] <= 0:
        # Beyond the strengths tried the score is taken as proportional.
        ratio = needed / score[at]
        return float(levels[at] / ratio if weaker_is_larger else levels[at] * ratio)
    ends = np.array([at, beyond])
    ends = ends[np.argsort(score[ends])]
    return float(np.exp(np.interp(np.log(needed), np.log(score[ends]), np.log(levels[ends]))))
