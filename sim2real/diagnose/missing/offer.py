"""Which effects the enriched model has: what is named, or more where that predicts better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.calibrated_odds import judged_together
from sim2real.diagnose.missing.investigate import Finding
from sim2real.effects import named
from sim2real.identification.held_out import Unseen, held_out
from sim2real.identification.servo_problem import Hypothesis, Set


def judged_and_offered(
    joints: Sequence[JointCase],
    findings: Sequence[Finding],
    robots: Sequence[Sequence[int]],
    device: str,
) -> tuple[list[Finding], list[Hypothesis], list[Hypothesis], list[dict[Set, Unseen]]]:
    """Judge findings by errors on held-out data, and choose the servo of the enriched model.

    Findings against references are judged already: they are offered as they are named.

    Returns:
        For each joint the finding, the servo with what was found, the one that is offered, and the
        errors on held-out data by set of effects.
    """
    judgements, errors = list(findings), [dict[Set, Unseen]() for _ in joints]
    searched = [j for j, joint in enumerate(joints) if not joint.references]
    _add_errors(errors, joints, findings, [_sets_to_score(f) for f in findings], device)
    for robot in robots:
        some = [j for j in robot if j in searched]
        together = judged_together([findings[j] for j in some], [errors[j] for j in some])
        for j, judgement in zip(some, together, strict=True):
            judgements[j] = judgement
    enriched = [_with_named(finding) for finding in judgements]
    _add_errors(errors, joints, judgements, [[servo.members] for servo in enriched], device)
    for j in searched:
        enriched[j] = _enriched(judgements[j], enriched[j], errors[j])
    fewer = [simpler(*of_joint) for of_joint in zip(judgements, enriched, errors, strict=True)]
    _add_errors(errors, joints, judgements, [[members] for members in fewer], device)
    offered = list(enriched)
    for j in searched:
        offered[j] = offer(judgements[j], enriched[j], fewer[j], errors[j])
    return judgements, enriched, offered, errors


def _add_errors(
    errors: Sequence[dict[Set, Unseen]],
    joints: Sequence[JointCase],
    findings: Sequence[Finding],
    sets: Sequence[Sequence[Set]],
    device: str,
) -> None:
    """Add the held-out errors of those sets of effects of each joint that have none yet.

    The plain servo is refitted for prediction; others keep the noise model of their fit. A
    recording that was designed to tell effects apart shows what the others do not, so that a fit to
    these alone would not predict it even with the right effects: only ends are held out then.
    """
    jobs = [
        (j, members)
        for j, of_joint in enumerate(sets)
        for members in dict.fromkeys(of_joint)
        if members not in errors[j]
    ]
    for white in (True, False):
        some = [(j, members) for j, members in jobs if (members == findings[j].tried.base) == white]
        if not some:
            continue
        traces = [joints[j].traces for j, _ in some]
        servos = [findings[j].tried.tried[members].fit.servos for j, members in some]
        ends = [bool(joints[j].stated) for j, _ in some]
        scores = held_out(traces, servos, white=white, ends=ends, device=device)
        for (j, members), score in zip(some, scores, strict=True):
            if score is not None:
                errors[j][members] = score


def _sets_to_score(finding: Finding) -> list[Set]:
    """The sets whose errors on held-out data say what each effect is worth."""
    best, base, tried = finding.best.members, finding.tried.base, finding.tried.tried
    fewer = (best - {effect} for effect in best - base)
    return [base, best, *(members for members in fewer if members in tried)]


def _with_named(finding: Finding) -> Hypothesis:
    """The servo with what is named on the joint, or the plain one; no findings stay as they are."""
    tried, best = finding.tried, finding.best
    heads = {g.members[0] for g in finding.groups if g.probability >= DECISION.named}
    wanted = best.members - (finding.effects - heads)
    if finding.link is not None:
        wanted &= heads | {name for name in wanted if named(name).everywhere}
    return tried.tried.get(tried.base | wanted, best if heads else tried.plain)


def _enriched(finding: Finding, fewer: Hypothesis, unseen: Mapping[Set, Unseen]) -> Hypothesis:
    """The servo that predicts better: with what is named, or with all of the likeliest set.

    What is too unsure to be named may well be there, or stand in for what is.
    """
    best, less = unseen.get(finding.best.members), unseen.get(fewer.members)
    if not finding.mismatch or finding.link is not None or best is None or less is None:
        return fewer
    return finding.best if best.rmse < less.rmse else fewer


def simpler(finding: Finding, enriched: Hypothesis, unseen: Mapping[Set, Unseen]) -> Set:
    """The effects of a servo without the negligible ones; all of them where that was not tried."""
    added = enriched.members - finding.tried.base
    negligible = {e for e in added if finding.changes(unseen, e) < DECISION.negligible}
    fewer = enriched.members - negligible
    return fewer if fewer in finding.tried.tried else enriched.members


def offer(
    finding: Finding, enriched: Hypothesis, fewer: Set, unseen: Mapping[Set, Unseen]
) -> Hypothesis:
    """The servo of the enriched model: the one with fewer effects, unless more predict better."""
    less, more = unseen.get(fewer), unseen.get(enriched.members)
    if less is None or more is None:
        return enriched
    better = more.rmse < (1 - DECISION.predictor.min_improvement) * less.rmse
    return enriched if better else finding.tried.tried[fewer]
