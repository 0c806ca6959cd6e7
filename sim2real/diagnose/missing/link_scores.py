"""Held-out scores of the links that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.link_score import ScoreJob, link_score
from sim2real.diagnose.missing.investigate import Finding, link_data
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import Set
from sim2real.processes import shared
from sim2real.servo.batch import Batch

Errors = Sequence[Mapping[Set, Unseen]]


def with_link_scores(
    batch: Batch,
    joints: Sequence[JointCase],
    robots: Sequence[Sequence[int]],
    findings: Sequence[Finding],
    errors: Errors,
) -> list[Finding]:
    """The findings, each link that is named with the likelihood of held-out recordings.

    Args:
        batch: The recordings, joint by joint.
        joints: The joints of the batch.
        robots: Which of them share a link.
        findings: What each is missing.
        errors: Held-out errors of each joint, by its servo's effects.
    """
    jobs: dict[tuple[int, ...], ScoreJob] = {}
    for robot in robots:
        named = [j for j in robot if _names_link(findings[j])]
        if not named:
            continue
        link = max((findings[j].link for j in named), key=lambda x: x.gain if x else 0.0)
        assert link is not None
        some = tuple(robot) if len(link.shares) == len(robot) else (named[0],)
        residuals = [_unseen_residuals(joints[j], findings[j], errors[j]) for j in some]
        comparable = len({len(x) for x in residuals}) == 1 and len(residuals[0]) > 1
        if comparable:
            data = link_data(batch, joints, some, [findings[j].best for j in some])
            jobs[some] = ScoreJob(data, tuple(residuals), link)
    scored = list(findings)
    for some, score in zip(jobs, shared(link_score, list(jobs.values())), strict=True):
        for j in some:
            link = findings[j].link
            if link is not None:
                scored[j] = replace(findings[j], link=replace(link, score=score))
    return scored


def _names_link(finding: Finding) -> bool:
    link = finding.link
    return link is not None and any(
        group.members[0] == link.effect and group.probability >= DECISION.named
        for group in finding.groups
    )


def _unseen_residuals(
    joint: JointCase, finding: Finding, errors: Mapping[Set, Unseen]
) -> tuple[Array, ...]:
    """Residual of each recording under the servo fitted to the others, 0 where not used, (T,)."""
    unseen = errors.get(finding.best.members)
    if unseen is None or len(unseen.residuals) != len(joint.traces):
        return ()
    residuals = []
    for trace, values in zip(joint.traces, unseen.residuals, strict=True):
        residual = np.zeros(trace.t.size)
        residual[trace.used] = values
        residuals.append(residual)
    return tuple(residuals)
