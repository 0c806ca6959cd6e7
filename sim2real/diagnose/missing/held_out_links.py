"""Held-out scores of the links that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.link_effect import LinkData
from sim2real.diagnose.link.link_score import ScoreJob, link_score
from sim2real.diagnose.missing.investigate import Finding, link_data
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import Set
from sim2real.progress import shared
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
        folds = _folds(batch, joints, some, [findings[j] for j in some], errors)
        if len(folds) > 1:
            jobs[some] = ScoreJob(folds, link)
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


def _folds(
    batch: Batch,
    joints: Sequence[JointCase],
    some: Sequence[int],
    findings: Sequence[Finding],
    errors: Errors,
) -> tuple[LinkData, ...]:
    """For each recording the residuals of servos fitted to the others; empty without such fits."""
    unseen = [errors[j].get(f.best.members) for j, f in zip(some, findings, strict=True)]
    counts = {0 if u is None else len(u.theta) for u in unseen}
    counts |= {len(joints[j].traces) for j in some}
    if len(counts) > 1:
        return ()
    folds = []
    for k in range(counts.pop()):
        servos = [
            replace(f.best.fit.servos, theta=u.theta[k : k + 1])
            for f, u in zip(findings, unseen, strict=True)
            if u is not None
        ]
        fits = [replace(f.best.fit, servos=s) for f, s in zip(findings, servos, strict=True)]
        folds.append(link_data(batch, joints, some, fits))
    return tuple(folds)
