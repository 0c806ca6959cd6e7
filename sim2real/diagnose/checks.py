"""What a person wants to see besides the findings: figures, floors, limits, the next experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.case import Case, gate
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.formula import guesses
from sim2real.diagnose.joint_result import JointResult
from sim2real.diagnose.knockoffs import best_knockoff, directions, false_discovery_of
from sim2real.diagnose.next_experiment import for_rivals
from sim2real.diagnose.result import DetectionLimit, Diagnosis, Evidence, Ladder
from sim2real.servo.black_box import black_box
from sim2real.servo.holdout import splits
from sim2real.servo.linear import residual_torque, smooth_speed
from sim2real.servo.screen import Candidate, Screen

Array = NDArray[np.float64]

_NINE_IN_TEN = 1.28


def with_checks(
    found: Diagnosis, case: Case, joints: Sequence[JointResult], rng: np.random.Generator
) -> Diagnosis:
    """The diagnosis of one robot with all that its report shows.

    Args:
        found: The diagnosis.
        case: The robot.
        joints: What is known of its joints.
        rng: For knockoffs and black boxes.
    """
    return replace(
        found,
        gate=gate(case),
        evidence=tuple(e for one in joints for e in _evidence(one)),
        detection_limits=tuple(limit for one in joints for limit in _limits(one)),
        ladders={one.signal: x for one in joints if (x := _ladder(one, rng)) is not None},
        hypothesis=guesses(joints),
        false_discovery_rate=false_discovery_of(joints, rng),
        next_experiment=for_rivals(case.robot, joints),
    )


def _limits(one: JointResult) -> list[DetectionLimit]:
    tried = one.finding.tried
    members = one.rich.members if one.rich.members in tried.tried else tried.base
    return detection_limits(*one.finding.search.seen(tried, members), one.name)


def _ladder(one: JointResult, rng: np.random.Generator) -> Ladder | None:
    """Held-out errors of ever better informed predictors; None where nothing is held out."""
    unseen, figures = one.unseen_plain, one.heldout()
    before, after = figures["rmse_before"], figures["rmse_after"]
    if unseen is None or before is None or after is None:
        return None
    finding, traces = one.finding, one.joint.traces
    servo = finding.tried.plain.fit.servos
    options = finding.search.seen(finding.tried, finding.tried.base)[1]
    moved = directions(traces, servo, [c for c in options if not c.effect.everywhere]).effects
    folds = splits(traces, unseen)
    return Ladder(
        baseline=before,
        enriched=after,
        best_decoy=best_knockoff(traces, servo, moved, folds, rng),
        black_box=black_box(folds, rng),
        noise=one.joint.noise,
    )


def _evidence(one: JointResult) -> list[Evidence]:
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
            Evidence(
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
    needed = float(np.sqrt(2 * DECISION.detection_gain)) + _NINE_IN_TEN
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
