"""What a person wants to see besides the findings: figures, floors, limits, the next experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.black_box import black_box
from sim2real.diagnose.candidates import RIPPLE
from sim2real.diagnose.decoy_error import best_decoy
from sim2real.diagnose.directions import directions
from sim2real.diagnose.experiment import next_experiment
from sim2real.diagnose.false_names import share_of_false_names
from sim2real.diagnose.guess import guesses
from sim2real.diagnose.heldout import Unseen
from sim2real.diagnose.investigate import Finding
from sim2real.diagnose.limits import detection_limits
from sim2real.diagnose.result import DetectionLimit, Evidence, Experiment
from sim2real.diagnose.search import Hypothesis
from sim2real.diagnose.splits import splits
from sim2real.diagnose.torque import residual_torque, smooth_speed
from sim2real.robot import Robot
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


_MOST_RIVALS = 3


@dataclass(frozen=True)
class Extras:
    """Parts of a ``Diagnosis`` that one robot's report shows, by joint where they are mappings."""

    hypothesis: Mapping[str, str]
    false_discovery_rate: float
    best_decoy: Mapping[str, float]
    black_box: Mapping[str, float]
    detection_limits: tuple[DetectionLimit, ...]
    next_experiment: Experiment | None
    evidence: tuple[Evidence, ...]


def extras(
    robot: Robot,
    names: Sequence[str],
    joints: Sequence[Sequence[Trace]],
    noise: Sequence[float],
    findings: Sequence[Finding],
    rich: Sequence[Hypothesis],
    residuals: tuple[Sequence[Array], Sequence[Array]],
    unseen: Sequence[Unseen | None],
    rng: np.random.Generator,
) -> Extras:
    """Work them out for one robot.

    Args:
        robot: The robot.
        names: Its joints.
        joints: Their recordings.
        noise: Standard deviations of their sensors' noise, rad.
        findings: What was found on them.
        rich: The servos with what is named.
        residuals: Simulated minus measured angles of the plain servos and of these, (R, T) each.
        unseen: The plain servos on what their refits have not seen.
        rng: For decoys and black boxes.
    """
    evidence, limits = [], []
    decoy, floor = {}, {}
    for k, name in enumerate(names):
        book = findings[k].book
        for r, trace in enumerate(joints[k]):
            evidence.append(
                _evidence(
                    name, trace, findings[k], residuals[0][k][r], residuals[1][k][r], noise[k]
                )
            )
        seen = rich[k].effects if rich[k].effects in book.screens else book.base
        limits += detection_limits(book.screens[seen], book.starts[seen], name)
        apart = unseen[k]
        if apart is not None:
            decoy[name], floor[name] = _floors(joints[k], findings[k], apart, rng)
    return Extras(
        hypothesis=guesses(names, joints, findings, rich, residuals[1]),
        false_discovery_rate=share_of_false_names(joints, findings, rng),
        best_decoy=decoy,
        black_box=floor,
        detection_limits=tuple(limits),
        next_experiment=_next(robot, names, joints, findings),
        evidence=tuple(evidence),
    )


def _floors(
    traces: Sequence[Trace], finding: Finding, unseen: Unseen, rng: np.random.Generator
) -> tuple[float, float]:
    """Held-out errors of the plain servo with the best decoy, and with a black box, rad."""
    book = finding.book
    servo = book.plain.fit.servos
    effects = [c for c in book.starts[book.base] if c.effect.name != RIPPLE]
    moved = directions(traces, servo, effects).effects
    folds = splits(traces, unseen)
    return best_decoy(traces, servo, moved, folds, rng), black_box(folds, rng)


def _next(
    robot: Robot,
    names: Sequence[str],
    joints: Sequence[Sequence[Trace]],
    findings: Sequence[Finding],
) -> Experiment | None:
    """The next experiment for the first group of several members."""
    for name, traces, finding in zip(names, joints, findings, strict=True):
        for group in finding.groups:
            rest = finding.best.effects - {group.members[0]}
            rivals = [finding.book.tried.get(rest | {member}) for member in group.members]
            known = [
                (member, rival)
                for member, rival in zip(group.members, rivals, strict=True)
                if rival is not None
            ][:_MOST_RIVALS]
            limits = robot.joint(name)
            if len(known) > 1 and limits is not None:
                reach = 0.9 * min(abs(x) for x in limits.limits_rad)
                members, fits = zip(*known, strict=True)
                return next_experiment(traces[0], fits, members, name, reach)
    return None


def _evidence(
    joint: str, trace: Trace, finding: Finding, before: Array, after: Array, noise: float
) -> Evidence:
    used = trace.used
    size = trace.t.size
    position = np.where(used, trace.position, np.nan)
    theta = finding.book.plain.fit.servos.theta[0]
    servo = (trace.load.inertia_kgm2, float(theta[1]), float(theta[0]) + trace.load.gravity_Nm)
    plain, rich = (_angle(trace, x[:size]) for x in (before, after))
    left = np.where(used, plain - position, np.nan)
    torque, sd = residual_torque(trace.t, left, servo, noise)
    return Evidence(
        joint=joint,
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


def _angle(trace: Trace, residual: Array) -> Array:
    """Simulated angles; between their neighbours where none was measured."""
    known = np.flatnonzero(trace.used)
    angle = residual[known] + trace.position[known]
    return np.asarray(np.interp(trace.t, trace.t[known], angle))
