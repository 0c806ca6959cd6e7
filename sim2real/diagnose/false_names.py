"""How many of the named effects are wrong, as far as decoys can tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.diagnose.candidates import RIPPLE
from sim2real.diagnose.decoys import COPIES, contest, false_discovery_rate
from sim2real.diagnose.directions import directions
from sim2real.diagnose.investigate import Finding
from sim2real.diagnose.naming import NAMED
from sim2real.diagnose.posterior import Group
from sim2real.diagnose.search import Set
from sim2real.servo.trace import Trace


def share_of_false_names(
    joints: Sequence[Sequence[Trace]],
    findings: Sequence[Finding],
    rng: np.random.Generator,
    copies: int = COPIES,
) -> float:
    """Expected share of wrong ones among the effects that are named on a robot's joints.

    Each named effect is judged against decoys of all effects, from the fit that lacks it and has
    the others. What is heard on the link or read off the sensor's numbers is no part of this. It
    says how often chance would pass for an effect, not how often one effect passes for another.

    Args:
        joints: Recordings of each joint.
        findings: What was found on it.
        rng: For the decoys.
        copies: Decoys of each effect.
    """
    chances, considered = [], 0
    for traces, finding in zip(joints, findings, strict=True):
        considered += len(_judged(finding, finding.book.base))
        for group in finding.groups:
            if group.probability >= NAMED and set(group.members) & finding.best.effects:
                chances.append(_chance(traces, finding, group, rng, copies))
    return false_discovery_rate(chances, considered)


def _chance(
    traces: Sequence[Trace],
    finding: Finding,
    group: Group,
    rng: np.random.Generator,
    copies: int,
) -> float:
    book = finding.book
    without = finding.best.effects - set(group.members)
    if without not in book.starts or without not in book.tried:
        without = book.base
    index = _judged(finding, without)
    candidates = [book.starts[without][k] for k in index]
    fit = book.tried[without].fit
    given = directions(traces, fit.servos, candidates)
    result = contest(traces, given, fit.autoregression[0], rng, copies)
    return result.chance([k for k, c in enumerate(candidates) if c.effect.name in group.members])


def _judged(finding: Finding, effects: Set) -> list[int]:
    """Indices of the candidates that may be named: ripple is only where it is large."""
    members = {name for group in finding.groups for name in group.members}
    return [
        k
        for k, option in enumerate(finding.book.starts[effects])
        if option.effect.name != RIPPLE or RIPPLE in members
    ]
