"""From recordings to a diagnosis: is something missing, where, what, and what to do next."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sim2real.diagnose.case import Case, JointCase, by_robot, lines_beside, on_their_lines, prepared
from sim2real.diagnose.changed.references import against_references, with_known_servos
from sim2real.diagnose.clocks import on_one_clock
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.missing.baseline import baselines
from sim2real.diagnose.missing.best_predictor import BEFORE, predicting
from sim2real.diagnose.missing.calibrated_odds import judged
from sim2real.diagnose.missing.investigate import Finding, investigate, placed
from sim2real.diagnose.missing.nuisances import first_look
from sim2real.diagnose.missing.offer import offer, simpler
from sim2real.diagnose.missing.servo_search import ServoSearch, ledgers_of
from sim2real.diagnose.page.supplements import with_checks
from sim2real.diagnose.page.wording import diagnosis
from sim2real.diagnose.result import Diagnosis
from sim2real.effects import named
from sim2real.identification.fit import Fit, refitted
from sim2real.identification.held_out import Unseen, held_out
from sim2real.identification.servo_problem import Hypothesis, Set, Tried, joined, residual_angles
from sim2real.model import Model
from sim2real.plausible import validate_recording
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.batch import Batch

__all__ = ["Case", "diagnose", "diagnose_all"]

Progress = Callable[[float], None]

_ALIKE = 1.25
"""Sampling periods that differ by less than about that may share a batch: its noise model has one
memory, in samples, for all of them."""


def diagnose(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    model: Model | None = None,
    references: Sequence[Recording] = (),
    negligible: float = DECISION.negligible,
    seed: int = 0,
    progress: Progress = lambda share: None,
) -> Diagnosis:
    """Find the physics that a fitted servo leaves out.

    Args:
        recordings: Recordings of the servos.
        robot: The robot that was recorded.
        model: A model to start from; its effects stay part of the plain servo.
        references: Recordings of the robot from before: then only what has changed since is named.
        negligible: An effect that changes the held-out error by less than this share is listed, and
            makes no verdict.
        seed: Seed of the bootstraps.
        progress: Called with the share that is done.

    Returns:
        The diagnosis, with the enriched model and what a report shows.

    Raises:
        InputError: If the recordings and the robot do not agree, or no joint moves.
    """
    case = Case(recordings, robot, model, references)
    (found,) = diagnose_all(
        [case],
        negligible=negligible,
        seed=seed,
        thorough=True,
        progress=lambda share: progress(BEFORE * share),
    )
    return predicting(found, recordings, seed, progress)


def diagnose_all(
    cases: Sequence[Case],
    *,
    negligible: float = DECISION.negligible,
    seed: int = 0,
    device: str = "cpu",
    thorough: bool = False,
    progress: Progress = lambda share: None,
) -> list[Diagnosis]:
    """Diagnose any number of robots together, all their simulations in a few launches.

    Args:
        cases: The robots.
        negligible: As of ``diagnose``.
        seed: Seed of the bootstraps.
        device: Warp device.
        thorough: Whether to work out detection limits, the next experiment and what the figures
            show as well.
        progress: Called with the share that is done.
    """
    found = []
    for case, joints in examined(cases, seed=seed, device=device, progress=progress):
        found.append(diagnosis(case, joints, negligible, seed))
        if thorough:
            found[-1] = with_checks(found[-1], case, joints)
    return found


def examined(
    cases: Sequence[Case],
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress = lambda share: None,
) -> list[tuple[Case, list[JointFindings]]]:
    """What is known of each joint of each robot, before it is put into words; as ``diagnose_all``.

    Returns:
        For each robot the case with the servos that were taken for granted, and its joints.
    """
    for case in cases:
        for recording in (*case.recordings, *case.references):
            validate_recording(recording, case.robot)
    found: dict[int, tuple[Case, list[JointFindings]]] = {}
    for group, step in sampled_alike([case.recordings for case in cases], progress):
        rng = np.random.default_rng(seed)
        some = with_known_servos([cases[k] for k in group], rng)
        some = [on_their_lines(case, rng) for case in some]
        results = _joint_results(some, rng, device, step)
        found.update(zip(group, zip(some, results, strict=True), strict=True))
        step(1.0)
    return [found[k] for k in range(len(cases))]


def sampled_alike(
    robots: Sequence[Sequence[Recording]], progress: Progress
) -> Iterator[tuple[list[int], Progress]]:
    """Places of the robots, given as their recordings, in groups of like sampling period.

    Each group comes with what to call with the share of it that is done.
    """
    groups: dict[int, list[int]] = defaultdict(list)
    for k, recordings in enumerate(robots):
        steps = np.concatenate([np.diff(recording.t) for recording in recordings])
        period = float(np.median(steps)) if steps.size else 1.0
        groups[round(np.log(period) / np.log(_ALIKE))].append(k)
    ends = np.cumsum([0, *(len(group) for group in groups.values())]) / len(robots)
    for group, (begin, end) in zip(groups.values(), pairwise(ends), strict=True):

        def step(share: float, begin: float = begin, end: float = end) -> None:
            progress(float(begin + share * (end - begin)))

        yield group, step


def _joint_results(
    cases: Sequence[Case], rng: np.random.Generator, device: str, progress: Progress
) -> list[list[JointFindings]]:
    """Findings on the joints of robots that were sampled alike, a list for each robot."""
    robots_joints = [prepared(case) for case in cases]
    robots = by_robot(robots_joints)
    recorded = [joint for some in robots_joints for joint in some]
    joints, first_ledgers = _first_look(recorded, rng, device)
    if not any(joint.before for joint in joints):
        batch = Batch([joint.traces for joint in joints], device)
        joints = on_one_clock(batch, joints, robots, [ledger.best for ledger in first_ledgers])
    batch = Batch([joint.traces for joint in joints], device)
    findings = investigate(
        batch,
        joints,
        robots,
        rng=rng,
        known=first_ledgers,
        progress=lambda share: progress(0.8 * share),
    )
    compared = [against_references(batch, *one) for one in zip(joints, findings, strict=True)]
    scores: list[dict[Set, Unseen]] = [{} for _ in joints]

    def score(sets: Sequence[Sequence[Set]], of: Sequence[Finding]) -> None:
        """Add the held-out errors of sets of effects of each joint that have none yet."""
        missing = [
            [members for members in dict.fromkeys(some) if members not in known]
            for some, known in zip(sets, scores, strict=True)
        ]
        for known, added in zip(scores, _unseen(joints, missing, of, device), strict=True):
            known.update(added)

    pairs = zip(findings, compared, strict=True)
    score([[*_all_sets(found), *_all_sets(changed)] for found, changed in pairs], compared)
    findings = [
        changed if joint.before else judged(found, errors)
        for joint, found, changed, errors in zip(joints, findings, compared, scores, strict=True)
    ]
    named_only = [_with_what_is_named(finding) for finding in findings]
    score([[fit.members] for fit in named_only], findings)
    enriched = [
        fit if joint.before else _enriched(finding, fit, errors)
        for joint, finding, fit, errors in zip(joints, findings, named_only, scores, strict=True)
    ]
    smaller = [simpler(*one) for one in zip(findings, enriched, scores, strict=True)]
    score([[members] for members in smaller], findings)
    offered = [
        fit if joint.before else offer(finding, fit, members, errors)
        for joint, finding, fit, members, errors in zip(
            joints, findings, enriched, smaller, scores, strict=True
        )
    ]
    plain = [finding.tried.plain for finding in findings]
    before, after = (
        residual_angles(batch, joined([fit.fit for fit in fits])) for fits in (plain, offered)
    )
    results = [
        JointFindings(
            joint,
            findings[j],
            enriched[j],
            offered[j],
            before[j],
            after[j],
            _refitted_plain(recorded[j], plain[j]).row,
            scores[j],
        )
        for j, joint in enumerate(joints)
    ]
    return [[results[j] for j in robot] for robot in robots]


def _refitted_plain(joint: JointCase, plain: Hypothesis) -> Fit:
    """The plain servo fitted as ``identify`` does, without what every servo has a little of."""
    effects = [named(effect) for effect in sorted(plain.members)]
    theta = plain.fit.servos.theta[0]
    return refitted(joint.traces, theta, [e for e in effects if not e.everywhere])


def _first_look(
    joints: Sequence[JointCase], rng: np.random.Generator, device: str
) -> tuple[list[JointCase], list[Tried]]:
    """The joints, on their lines where that shows beside what explains them best, and all tried."""
    batch = Batch([joint.traces for joint in joints], device)
    ledgers = _looked(batch, joints, rng)
    lined = lines_beside(batch, joints, [one.best for one in ledgers])
    found = [replace(one, given=lined.get(j, one.given)) for j, one in enumerate(joints)]
    if lined:
        some = [found[j] for j in lined]
        again = Batch([one.traces for one in some], device, period=batch.period)
        for j, one in zip(lined, _looked(again, some, rng), strict=True):
            ledgers[j] = placed(one, j)
    return found, ledgers


def _looked(batch: Batch, joints: Sequence[JointCase], rng: np.random.Generator) -> list[Tried]:
    plain = baselines(batch, [joint.given for joint in joints])
    ledgers = ledgers_of(plain, [joint.base for joint in joints])
    if all(joint.before for joint in joints):
        return ledgers
    large = [DECISION.nuisance_finding_size * joint.noise for joint in joints]
    first_look(ServoSearch(batch, DECISION.false_alarms, rng), ledgers, large)
    return ledgers


def _enriched(finding: Finding, named: Hypothesis, unseen: Mapping[Set, Unseen]) -> Hypothesis:
    """The servo that foretells best: with what is named, or with all of the likeliest set.

    What is too unsure to be named may well be there, or stand in for what is.
    """
    best, fewer = unseen.get(finding.best.members), unseen.get(named.members)
    if not finding.mismatch or finding.link is not None or best is None or fewer is None:
        return named
    return finding.best if best.rmse < fewer.rmse else named


def _with_what_is_named(finding: Finding) -> Hypothesis:
    """The servo with what is named on the joint, or the plain one; no findings stay as they are."""
    tried, best = finding.tried, finding.best
    heads = {g.members[0] for g in finding.groups if g.probability >= DECISION.named}
    wanted = best.members - (finding.said - heads)
    if finding.link is not None:
        wanted &= heads | {name for name in wanted if named(name).everywhere}
    wanted = tried.base | (wanted & best.members)
    return tried.tried.get(wanted, best if heads else tried.plain)


def _all_sets(finding: Finding) -> list[Set]:
    """The sets whose errors on held-out data say what each effect is worth."""
    best, base, tried = finding.best.members, finding.tried.base, finding.tried.tried
    fewer = [best - {effect} for effect in best - base]
    return list(dict.fromkeys([base, best, *(s for s in fewer if s in tried)]))


def _unseen(
    joints: Sequence[JointCase],
    sets: Sequence[Sequence[Set]],
    findings: Sequence[Finding],
    device: str,
) -> list[dict[Set, Unseen]]:
    """For each joint the errors of these sets of effects on held-out data."""
    jobs = [(j, s) for j, some in enumerate(sets) for s in some]
    servos = [findings[j].tried.tried[s].fit.servos for j, s in jobs]
    # The plain servo is refitted for prediction; what is named stands as it was found.
    found: list[dict[Set, Unseen]] = [{} for _ in joints]
    for white in (True, False):
        some = [k for k, (j, s) in enumerate(jobs) if (s == findings[j].tried.base) == white]
        if not some:
            continue
        scores = held_out(
            [joints[jobs[k][0]].traces for k in some],
            [servos[k] for k in some],
            white=white,
            device=device,
        )
        for k, score in zip(some, scores, strict=True):
            if score is not None:
                found[jobs[k][0]][jobs[k][1]] = score
    return found
