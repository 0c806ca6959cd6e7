"""What a report shows besides the findings: figures, errors, limits, the next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.check import all_findings, check
from sim2real.diagnose.case import Case
from sim2real.diagnose.changed.references import repeat
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.missing.screening import Candidate, Screen
from sim2real.diagnose.page.next_experiment import next_experiment
from sim2real.diagnose.result import DetectionLimit, Diagnosis, Experiment, JointSeries, Ladder
from sim2real.inference.normal import NINE_IN_TEN
from sim2real.robot import Robot
from sim2real.servo.linearised import residual_torque, smooth_speed

Array = NDArray[np.float64]


def with_checks(found: Diagnosis, case: Case, joints: Sequence[JointFindings]) -> Diagnosis:
    """The diagnosis of one robot with all that its report shows.

    Args:
        found: The diagnosis.
        case: The robot.
        joints: What is known of its joints.
    """
    checks = (
        f"{recording.name}: {sentence}"
        for recording in case.recordings
        for sentence in all_findings(check(recording, case.robot, identifiable=False))
    )
    return replace(
        found,
        gate=tuple(dict.fromkeys(checks)),
        evidence=tuple(e for one in joints for e in _evidence(one)),
        detection_limits=tuple(limit for one in joints for limit in _limits(one)),
        ladders={one.signal: x for one in joints if (x := _ladder(one)) is not None},
        next_experiment=repeat([one.joint for one in joints]) or _for_rivals(case.robot, joints),
    )


def _for_rivals(robot: Robot, joints: Sequence[JointFindings]) -> Experiment | None:
    """The next experiment for the first group of several members."""
    for one in joints:
        for group in one.finding.groups:
            rest = one.finding.best.members - {group.members[0]}
            tried = one.finding.tried.tried
            known = [(m, tried[rest | {m}]) for m in group.members if rest | {m} in tried]
            limits = robot.joint(one.name)
            if len(known) > 1 and limits is not None:
                reach = 0.9 * min(abs(x) for x in limits.limits_rad)
                members, fits = zip(*known[: DECISION.report.experiment_rivals], strict=True)
                return next_experiment(one.joint.traces[0], fits, members, one.name, reach)
    return None


def _limits(one: JointFindings) -> list[DetectionLimit]:
    tried = one.finding.tried
    members = one.rich.members if one.rich.members in tried.tried else tried.base
    return detection_limits(*one.finding.search.seen(tried, members), one.name)


def _ladder(one: JointFindings) -> Ladder | None:
    """Held-out errors of ever better informed predictors; None where nothing is held out."""
    before, after = (one.fit(enriched=enriched)["heldout"] for enriched in (False, True))
    if before is None or after is None:
        return None
    return Ladder(baseline=before, enriched=after, noise=one.joint.noise)


def _evidence(one: JointFindings) -> list[JointSeries]:
    theta = one.finding.tried.plain.fit.servos.theta[0]
    found = []
    for trace, before, after in zip(one.joint.traces, one.before, one.after, strict=False):
        known = np.flatnonzero(trace.used)
        plain, rich = (
            np.interp(trace.t, trace.t[known], residual[known] + trace.position[known])
            for residual in (before, after)
        )
        position = np.where(trace.used, trace.position, np.nan)
        stiffness = float(theta[0]) + trace.load.gravity_Nm
        torque, sd = residual_torque(
            trace.t,
            np.where(trace.used, plain - position, np.nan),
            (trace.load.inertia_kgm2, float(theta[1]), stiffness),
            one.joint.noise,
        )
        found.append(
            JointSeries(
                joint=one.name,
                recording=trace.name,
                t=trace.t,
                command=trace.command,
                position=position,
                baseline=plain,
                enriched=rich,
                speed=smooth_speed(trace.t, position),
                torque=torque,
                torque_sd=sd,
            )
        )
    return found


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
        visible = seen.visible[mine]
        name = option.effect.parameters[0].name
        limits.append(
            DetectionLimit(
                option.effect.name, component, {name: _crossing(strength, visible, needed)}
            )
        )
    return limits


def _crossing(strength: Array, visible: Array, needed: float) -> float | None:
    """Strength at which the score reaches what is needed; None where no start does."""
    levels = np.unique(strength)
    score = np.array([np.median(visible[strength == level]) for level in levels])
    shown = np.flatnonzero(score >= needed)
    if not shown.size:
        return None
    weaker_is_larger = score[0] > score[-1]
    at = int(shown[-1] if weaker_is_larger else shown[0])
    beyond = at + 1 if weaker_is_larger else at - 1
    if not 0 <= beyond < levels.size or score[beyond] <= 0:
        # Beyond the strengths tried the score is taken as proportional.
        ratio = needed / score[at]
        return float(levels[at] / ratio if weaker_is_larger else levels[at] * ratio)
    place = np.interp(
        np.log(needed),
        np.sort(np.log(score[[at, beyond]])),
        np.log(levels[[at, beyond]])[np.argsort(score[[at, beyond]])],
    )
    return float(np.exp(place))
