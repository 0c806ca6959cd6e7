"""What is said of a joint, once all that speaks for it is known.

What speaks for and against a finding is measured here, for the diagnosis and for
``benchmarks/calibrate_decisions.py`` alike; how much each counts, the curves of ``decision.json``
say, which were read off cases of known answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim2real.diagnose.decision import DECISION, ODDS
from sim2real.diagnose.joint_result import includes_zero
from sim2real.diagnose.missing.effect_probabilities import Group
from sim2real.diagnose.missing.investigate import ROUNDING, Finding
from sim2real.effects import named
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import Set

Features = dict[str, float]


@dataclass(frozen=True)
class OddsFeatures:
    """What speaks for and against all that could be said of a joint.

    Attributes:
        groups: Groups of effects, each with what speaks for it.
        whole: What speaks for something missing, and for something that has no name.
        link: What speaks for an uneven link; None where it is even.
    """

    groups: tuple[tuple[Group, Features], ...]
    whole: Features
    link: Features | None


def _logarithm(low: float, high: float) -> Callable[[float], float]:
    return lambda x: float(np.log(np.clip(x, low, high)))


def _gain(x: float) -> float:
    return float(np.log1p(np.clip(x, 0.0, 1e5)))


_SCALES: Mapping[str, Callable[[float], float]] = {
    "probability": lambda p: -_logarithm(1e-3, 1e3)(1 / np.clip(p, 0.02, 0.98) - 1),
    "changes": lambda x: _logarithm(3e-3, 1.0)(max(x, 0.0)) if x < 1e6 else 0.0,
    "lead": lambda x: float(np.clip(x, -60.0, 60.0)) / 20.0,
    "size": _logarithm(1e-2, 30.0),
    "left": _logarithm(0.3, 30.0),
    **dict.fromkeys(("error", "error_plain"), _logarithm(1.0, 30.0)),
    **dict.fromkeys(("excess", "excess_plain"), _logarithm(0.7, 30.0)),
    **dict.fromkeys(("without", "smooth", "windows", "own", "gain"), _gain),
}
"""How a measure enters a curve: what is none of these as it is."""


_BESIDE = ("excess_plain", "error_plain", "error")
"""Measures of the whole joint that count for each effect as well."""


def scaled(**measured: float) -> Features:
    """Measures as a curve takes them, and a constant beside them."""
    return {"one": 1.0} | {name: _SCALES.get(name, float)(x) for name, x in measured.items()}


def evidence(finding: Finding, unseen: Mapping[Set, Unseen]) -> OddsFeatures:
    """What speaks for and against all that could be said of a joint."""
    tried, best, link = finding.tried, finding.best, finding.link
    groups = [g for g in finding.groups if g.members != (ROUNDING,)]
    groups = [g for g in groups if link is None or link.effect not in g.members]
    without = finding.unmodelled
    smooth = without.smooth.evidence(float(best.fit.count[0]))
    # Evidence by which a function without a name is ahead of the best set.
    lead = smooth - (best.evidence - tried.plain.evidence)
    gain, limit = finding.search.left(tried, best.members)
    left = gain / max(limit, 1e-9)
    # What no group says is no finding, and not missing.
    small = best.members - tried.base - finding.said
    servo = tried.tried.get(tried.base | small, tried.plain)
    plain, rich = unseen.get(tried.base), unseen.get(best.members)
    more = max(without.excess - 1, 0.0)
    explained = np.clip((without.excess - finding.excess) / more, 0, 1) if more > 0.02 else 0.5
    whole = scaled(
        excess_plain=without.excess,
        excess=finding.excess,
        explained=explained,
        smooth=smooth,
        windows=without.windows_evidence,
        lead=lead,
        own=best.evidence - servo.evidence,
        left=left,
        groups=len(groups),
        error_plain=1.0 if plain is None else plain.rmse / finding.noise,
        error=1.0 if rich is None else rich.rmse / finding.noise,
    )
    weighed = []
    for group in groups:
        head, known = group.members[0], group.members
        fewer = tried.tried.get(best.members - {head}, tried.plain)
        features = scaled(
            probability=group.probability,
            without=best.evidence - fewer.evidence,
            changes=finding.changes(unseen, head),
            groups=len(groups) - 1,
            excess=finding.excess,
            lead=lead,
        )
        beside = {f"all {name}": whole[name] for name in _BESIDE}
        names = {f"is {name}": 1 / len(known) for name in known}
        weighed.append((group, features | beside | names))
    uneven = None
    if link is not None:
        uneven = scaled(
            gain=link.gain,
            showing=float(np.mean([x > 0 for x in link.shares])),
            excess=finding.excess,
            size=finding.uneven,
            lone=len(link.shares) == 1,
        )
    return OddsFeatures(tuple(weighed), whole, uneven)


def _has_no_name(group: Group) -> bool:
    """Whether it is what every sensor has a little of, and this one more than any in order."""
    return named(group.members[0]).never_named


def judged(finding: Finding, unseen: Mapping[Set, Unseen]) -> Finding:
    """The finding with probabilities that were read off cases of known answer.

    An effect whose size may as well be 0 is not named, whatever else speaks for it.
    """
    found = evidence(finding, unseen)
    unknown = ODDS["nameless"].probability(found.whole)
    if any(_has_no_name(g) for g, _ in found.groups):
        unknown = max(unknown, DECISION.nameless)

    def stated(curve: str, features: Features) -> float:
        """That a name is right: what is missing has one, and it is this."""
        probability = (1 - unknown) * ODDS[curve].probability(features)
        # Not 0.9 where those that are said with 0.9 would too often be wrong.
        return (
            probability if probability >= DECISION.sure else min(probability, DECISION.below_sure)
        )

    groups = [
        replace(g, probability=stated("effect", told))
        for g, told in found.groups
        if not _has_no_name(g) and not includes_zero(finding.best, g.members[0])
    ]
    coarse = [g for g in finding.groups if g.members == (ROUNDING,)]
    if finding.link is not None and found.link is not None:
        groups.append(Group((finding.link.effect,), stated("link", found.link), 1.0))
    likely = [g for g in groups if g.probability >= DECISION.named]
    matters = [g for g in likely if finding.changes(unseen, g.members[0]) >= DECISION.negligible]
    there = ODDS["there"].probability(found.whole) >= DECISION.there
    mismatch = bool(coarse or matters) or there or unknown > DECISION.named
    # What explains a trifle does not explain what is left beside it.
    trifles = not matters and finding.excess > DECISION.structured
    unsolved = there and not coarse and (not likely or trifles)
    return replace(
        finding,
        mismatch=mismatch,
        groups=tuple(sorted([*coarse, *groups], key=lambda g: -g.probability)),
        left=unknown > DECISION.named or unsolved,
        unknown=unknown,
    )
