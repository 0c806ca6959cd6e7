"""Against references: the question is what has changed since, not what a servo lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.case import Case, Joint, by_robot, prepared
from sim2real.diagnose.change import what_changed
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.investigate import ROUNDING, Finding, investigate
from sim2real.diagnose.joint_result import servo
from sim2real.model import Model
from sim2real.noise import quantization_step
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import joint_row
from sim2real.servo.plain import BLOCKS, with_effects
from sim2real.servo.problem import Hypothesis, minimise

Array = NDArray[np.float64]


def with_known_servos(
    cases: Sequence[Case], rng: np.random.Generator, device: str = "cpu"
) -> list[Case]:
    """Cases whose model is the likeliest servo of their references, where none is given.

    Args:
        cases: The cases.
        rng: For bootstraps.
        device: Warp device.

    Raises:
        InputError: If references and robot do not agree, or no joint moves in them.
    """
    before = {
        k: prepared(replace(case, recordings=case.references, references=()))
        for k, case in enumerate(cases)
        if case.references
    }
    some = [k for k in before if cases[k].model is None]
    known = list(cases)
    if not some:
        return known
    joints = [joint for k in some for joint in before[k]]
    robots = by_robot([before[k] for k in some])
    batch = Batch([joint.traces for joint in joints], device)
    found = investigate(batch, joints, robots, rng=rng)
    for k, robot in zip(some, robots, strict=True):
        servos = {}
        for j in robot:
            # How finely a sensor reads, each recording says itself.
            best, joint = found[j].best, replace(joints[j], step_rad=None)
            servos[joint.name] = servo(joint, best.fit.servos.theta[0], best)
        known[k] = replace(cases[k], model=Model(joints=servos))
    return known


def against_references(batch: Batch, joint: Joint, finding: Finding) -> Finding:
    """The finding in which only what differs from the joint's references is named.

    Args:
        batch: The recordings that it is of.
        joint: The joint; one without references keeps its finding.
        finding: What is missing.
    """
    before = joint.before
    if not before:
        return finding
    grids = [quantization_step(np.where(t.used, t.position, np.nan)) for t in before]
    coarser = joint.step_rad is not None and joint.step_rad > DECISION.coarser * max(grids)
    tried = finding.tried
    plain = tried.plain.fit.servos
    starts = [plain.theta[0]]
    if joint.given is not None:
        starts.append(joint_row(joint.given, None, joint.name))
    inertia = before[0].load.inertia_kgm2
    kp, first = float(plain.theta[0, 0]), np.zeros(1, dtype=np.int32)
    servos = [
        replace(with_effects(plain, tried.base, theta, kp, inertia), joint=first, theta=theta[None])
        for theta in starts
    ]
    groups, found, theta = what_changed(before, joint.traces, servos, batch.device)
    named = groups[0].probability >= DECISION.named
    rich = tried.base | {group.members[0] for group in groups if named}
    if rich != tried.base and theta is not None:
        # As fitted to references and case together: the case alone says less of its servo.
        one = replace(with_effects(plain, rich, theta, kp, inertia), theta=theta[None].copy())
        fit = minimise(batch, one, iterations=1, blocks=BLOCKS)
        tried.tried[rich] = Hypothesis(rich, fit, float(fit.loglikelihood[0]))
    coarse = [g for g in finding.groups if g.members == (ROUNDING,)]
    return replace(
        finding,
        mismatch=finding.mismatch or named,
        best=tried.tried.get(rich, tried.plain),
        posterior=found.posterior(tried.base),
        groups=(*coarse, *groups) if coarser else groups,
        left=finding.left and not named,
        unknown=0.0 if named else finding.unknown,
        link=None,
    )
