"""Against references: the question is what has changed since, not what a servo lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.case import Case, Joint, places, prepared
from sim2real.diagnose.change import Change, what_changed
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.investigate import ROUNDING, Finding, investigate
from sim2real.diagnose.joint_result import servo
from sim2real.diagnose.posterior import Posterior
from sim2real.diagnose.search import BLOCKS, Hypothesis, Set, with_effects
from sim2real.model import Model
from sim2real.noise import quantization_step
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import BASE, joint_row
from sim2real.servo.problem import minimise
from sim2real.servo.trace import Trace, traces

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
    before = {k: prepared(case.before) for k, case in enumerate(cases) if case.references}
    some = [k for k in before if cases[k].model is None]
    known = list(cases)
    if not some:
        return known
    joints = [joint for k in some for joint in before[k]]
    robots = places([before[k] for k in some])
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


def against_references(
    batch: Batch,
    cases: Sequence[Case],
    joints: Sequence[Joint],
    robots: Sequence[Sequence[int]],
    findings: Sequence[Finding],
) -> list[Finding]:
    """Findings in which only what differs from the references is named.

    Args:
        batch: The recordings, joint by joint.
        cases: The robots; those without references keep their findings.
        joints: Their joints.
        robots: Which of these are each robot's.
        findings: What is missing, joint by joint.
    """
    changed = list(findings)
    for case, robot in zip(cases, robots, strict=True):
        for j in robot:
            before = traces(case.references, joints[j].name)
            if before:
                changed[j] = _changed(batch, joints[j], before, findings[j])
    return changed


def _changed(batch: Batch, joint: Joint, before: Sequence[Trace], finding: Finding) -> Finding:
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
        posterior=_posterior(tried.base, found),
        groups=(*coarse, *groups) if _coarser(joint, before) else groups,
        left=finding.left and not named,
        unknown=0.0 if named else finding.unknown,
        link=None,
    )


def _coarser(joint: Joint, before: Sequence[Trace]) -> bool:
    """Whether a joint's angles lie on a coarser grid than in its references."""
    grids = [quantization_step(np.where(t.used, t.position, np.nan)) for t in before]
    return joint.step_rad is not None and joint.step_rad > DECISION.coarser * max(grids)


def _posterior(base: Set, found: Change) -> Posterior:
    """The probabilities of a change as those of sets of effects, nothing more among them."""
    effects = {n: p for n, p in found.probability.items() if n not in (*BASE, *base)}
    order = sorted(effects, key=lambda n: -effects[n])
    sets = (base, *(base | {n} for n in order))
    probability = np.array([1 - sum(effects.values()), *(effects[n] for n in order)])
    return Posterior(sets, probability, probability)
