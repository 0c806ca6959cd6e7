"""From recordings to a diagnosis: is something missing, where, what, and what to do next."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sim2real.arm.arm_loads import with_arm_loads
from sim2real.arrays import Array
from sim2real.diagnose.case import Case, JointCase, prepared
from sim2real.diagnose.changed.references import against_references, with_known_servos
from sim2real.diagnose.clocks import on_one_clock
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.joint_result import JointFindings
from sim2real.diagnose.missing.baseline import baselines
from sim2real.diagnose.missing.best_predictor import BEFORE, predicting
from sim2real.diagnose.missing.held_out_links import with_link_scores
from sim2real.diagnose.missing.investigate import investigate, placed
from sim2real.diagnose.missing.nuisances import first_look
from sim2real.diagnose.missing.offer import judged_and_offered
from sim2real.diagnose.missing.servo_search import ServoSearch, ledgers_of
from sim2real.diagnose.page.supplements import with_checks
from sim2real.diagnose.page.wording import diagnosis
from sim2real.diagnose.result import Diagnosis
from sim2real.diagnose.torque_speed_line import models_with_limits, on_their_lines
from sim2real.effects import named
from sim2real.identification.plain_fit import refitted
from sim2real.identification.servo_problem import Hypothesis, Tried, joined, residual_angles
from sim2real.model import Model
from sim2real.plausible import admitted
from sim2real.progress import Progress
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.batch import Batch
from sim2real.servo.trace import at_one_gain, firmware_gain

__all__ = ["Case", "diagnose", "diagnose_all"]

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
    effort: float = 1.0,
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
        effort: Multiple of the simulation budget of the search for combinations of effects.
        seed: Seed of the bootstraps.
        progress: Called with the share that is done.

    Returns:
        The diagnosis, with the enriched model and what a report shows.

    Raises:
        InputError: If the recordings and the robot do not agree, or no joint moves.
    """
    gain = None if model is None else model.firmware_p_gain
    everything = at_one_gain([*references, *recordings], gain)
    loaded = with_arm_loads(everything, robot, model)
    references, recordings = loaded[: len(references)], loaded[len(references) :]
    case = Case(recordings, robot, model, references, effort)
    (result,) = diagnose_all(
        [case],
        negligible=negligible,
        seed=seed,
        thorough=True,
        progress=lambda share: progress(BEFORE * share),
    )
    if model is None:
        gain = next(filter(None, map(firmware_gain, everything)), None)
    result = replace(result, model=replace(result.model, firmware_p_gain=gain))
    kept, _ = admitted(recordings, robot)
    return predicting(result, kept, seed, progress, effort)


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
    results = []
    for case, joints in examined(cases, seed=seed, device=device, progress=progress):
        result = diagnosis(case, joints, negligible, seed)
        results.append(with_checks(result, case, joints) if thorough else result)
    return results


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
    cases = [_admitted(case) for case in cases]
    results: dict[int, tuple[Case, list[JointFindings]]] = {}
    for group, step in sampled_alike([case.recordings for case in cases], progress):
        rng = np.random.default_rng(seed)
        some = with_known_servos([cases[k] for k in group], rng)
        some = [on_their_lines(case, rng) for case in some]
        joints = _joint_results(some, rng, device, step)
        results.update(zip(group, zip(some, joints, strict=True), strict=True))
        step(1.0)
    return [results[k] for k in range(len(cases))]


def _admitted(case: Case) -> Case:
    """The case with what of its recordings may be fitted, and warnings about them."""
    kept, warnings = admitted((*case.recordings, *case.references), case.robot)
    count = len(case.recordings)
    return replace(case, recordings=kept[:count], references=kept[count:], warnings=warnings)


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
    of_robots = [prepared(case) for case in cases]
    recorded = [joint for of_robot in of_robots for joint in of_robot]
    ends = np.cumsum([0, *map(len, of_robots)])
    robots = [list(range(a, b)) for a, b in pairwise(ends)]
    joints, first_ledgers = _first_look(recorded, rng, device)
    if not any(joint.references for joint in joints):
        batch = Batch([joint.traces for joint in joints], device)
        joints = on_one_clock(batch, joints, robots, [ledger.best for ledger in first_ledgers])
    batch = Batch([joint.traces for joint in joints], device)
    findings = investigate(
        batch, joints, robots, first_ledgers, rng=rng, progress=lambda share: progress(0.8 * share)
    )
    findings = [against_references(batch, *pair) for pair in zip(joints, findings, strict=True)]
    findings, enriched, offered, errors = judged_and_offered(joints, findings, robots, device)
    findings = with_link_scores(batch, joints, robots, findings, errors)
    plain = [finding.tried.plain for finding in findings]
    before, after = (
        residual_angles(batch, joined([h.fit for h in servos])) for servos in (plain, offered)
    )
    fitted = [_least_squares(*pair) for pair in zip(recorded, plain, strict=True)]
    of_joints = zip(joints, findings, enriched, offered, before, after, fitted, errors, strict=True)
    results = [JointFindings(*of_joint) for of_joint in of_joints]
    return [[results[j] for j in robot] for robot in robots]


def _first_look(
    joints: Sequence[JointCase], rng: np.random.Generator, device: str
) -> tuple[list[JointCase], list[Tried]]:
    """The joints, with their motor's limit where that shows, and every set that was tried."""
    batch = Batch([joint.traces for joint in joints], device)
    ledgers = _looked(batch, joints, rng)
    lines = models_with_limits(batch, joints, [ledger.best for ledger in ledgers])
    if not lines:
        return list(joints), ledgers
    joints = [replace(joint, model=lines.get(j, joint.model)) for j, joint in enumerate(joints)]
    some = [joints[j] for j in lines]
    again = Batch([joint.traces for joint in some], device, period=batch.period)
    for j, ledger in zip(lines, _looked(again, some, rng), strict=True):
        ledgers[j] = placed(ledger, j)
    return joints, ledgers


def _looked(batch: Batch, joints: Sequence[JointCase], rng: np.random.Generator) -> list[Tried]:
    plain = baselines(batch, [joint.model for joint in joints])
    ledgers = ledgers_of(plain, [joint.base for joint in joints])
    if not all(joint.references for joint in joints):
        large = [DECISION.nuisance_finding_size * joint.noise for joint in joints]
        first_look(ServoSearch(batch, DECISION.false_alarms, rng), ledgers, large)
    return ledgers


def _least_squares(joint: JointCase, plain: Hypothesis) -> Array:
    """The plain servo as ``identify`` fits it, without what every servo has a little of, (P,)."""
    effects = [named(effect) for effect in sorted(plain.members)]
    theta = plain.fit.servos.theta[0]
    return refitted(joint.traces, theta, [e for e in effects if not e.everywhere]).row
