"""What is said of a joint, once all that speaks for it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim2real.diagnose.decision import DECISION, ODDS
from sim2real.diagnose.investigate import ROUNDING, Finding, by_evidence, nameless_lead
from sim2real.diagnose.odds import of_effect, of_link, of_nameless
from sim2real.diagnose.posterior import Group
from sim2real.diagnose.search import Set
from sim2real.effects import named
from sim2real.servo.holdout import Unseen

Features = dict[str, float]


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against all that could be said of a joint; see ``odds``.

    Attributes:
        groups: Groups of effects, that which explains most first, each with what speaks for it.
        whole: What speaks for something missing, and for something that has no name.
        link: What speaks for an uneven link; None where it is even.
    """

    groups: tuple[tuple[Group, Features], ...]
    whole: Features
    link: Features | None


def changes(finding: Finding, unseen: Mapping[Set, Unseen], effect: str) -> float:
    """Share by which an effect lowers the held-out error beside the others; or infinity.

    Infinity where that cannot be told: of rounding, and where nothing is held out. Of an uneven
    link, which nobody can foretell, it is the share by which it raises the error.
    """
    link, best = finding.link, finding.best
    if link is not None and link.effect == effect:
        return float(1 - np.exp(-_own_share(finding) / best.fit.count[0]))
    rich = unseen.get(best.members)
    without = unseen.get(best.members - {effect}, unseen.get(finding.tried.base))
    if effect not in best.members or rich is None or without is None:
        return float("inf")
    return 1 - rich.rmse / without.rmse


def evidence(finding: Finding, unseen: Mapping[Set, Unseen]) -> Evidence:
    """What speaks for and against all that could be said of a joint."""
    tried, best, link = finding.tried, finding.best, finding.link
    groups = [g for g in finding.groups if g.members != (ROUNDING,)]
    groups = by_evidence(tried, [g for g in groups if link is None or link.effect not in g.members])
    lead = nameless_lead(tried, best, finding.unmodelled)
    gain, limit = finding.search.left(tried, best.members)
    left = gain / max(limit, 1e-9)
    weighed = []
    for place, group in enumerate(groups):
        head, alone = group.members[0], [tried.base | {e} for e in group.members]
        fewer = tried.tried.get(best.members - {head})
        features = of_effect(
            head,
            probability=group.probability,
            stability=group.stability,
            alone=max(
                (tried.tried[s].evidence - tried.plain.evidence for s in alone if s in tried.tried),
                default=0.0,
            ),
            without=None if fewer is None else best.evidence - fewer.evidence,
            changes=changes(finding, unseen, head),
            place=place,
            groups=len(groups),
            members=len(group.members),
            excess=finding.excess,
            lead=lead,
            left=left,
        )
        weighed.append((group, features))
    # What every servo has a little of, and no group says, is not missing.
    said = {effect for group in finding.groups for effect in group.members}
    small = {e for e in best.members - tried.base if named(e).everywhere and e not in said}
    servo = tried.tried.get(tried.base | small, tried.plain)
    plain, rich = unseen.get(servo.members), unseen.get(best.members)
    whole = of_nameless(
        excess_plain=finding.unmodelled.excess,
        excess=finding.excess,
        smooth=finding.unmodelled.smooth.evidence(float(best.fit.count[0])),
        windows=finding.unmodelled.windows_evidence,
        lead=lead,
        own=best.evidence - servo.evidence,
        left=left,
        change=0.0 if plain is None or rich is None else 1 - rich.rmse / plain.rmse,
    )
    uneven = None
    if link is not None:
        uneven = of_link(
            gain=link.gain,
            showing=float(np.mean([x > DECISION.link_shows for x in link.shares])),
            worst=finding.excess,
            size=changes(finding, unseen, link.effect),
            joints=len(link.shares),
        )
    return Evidence(tuple(weighed), whole, uneven)


def judged(finding: Finding, unseen: Mapping[Set, Unseen]) -> Finding:
    """The finding with probabilities that were read off cases of known answer."""
    found = evidence(finding, unseen)
    unknown = ODDS["nameless"].probability(found.whole)
    groups = [
        replace(group, probability=ODDS["effect"].probability(features))
        for group, features in found.groups
    ]
    coarse = [g for g in finding.groups if g.members == (ROUNDING,)]
    if finding.link is not None and found.link is not None:
        sure = ODDS["link"].probability(found.link)
        groups.append(Group((finding.link.effect,), sure, 1.0))
    likely = [g for g in groups if g.probability >= DECISION.named]
    matters = [g for g in likely if changes(finding, unseen, g.members[0]) >= DECISION.negligible]
    there = ODDS["there"].probability(found.whole) >= DECISION.there
    mismatch = bool(coarse or matters) or there or unknown > DECISION.named
    return replace(
        finding,
        mismatch=mismatch,
        groups=tuple(sorted([*coarse, *groups], key=lambda g: -g.probability)),
        left=mismatch and (unknown > DECISION.named or (there and not likely and not coarse)),
        unknown=unknown,
    )


def with_nameless(changed: Finding, alone: Finding) -> Finding:
    """A finding against references, with what the recordings alone say of something nameless.

    Nothing is nameless where a change has a name.
    """
    said = any(group.probability >= DECISION.named for group in changed.groups)
    return changed if said else replace(changed, unknown=alone.unknown)


def _own_share(finding: Finding) -> float:
    """Log-likelihood that an uneven link gains at this joint; of all where it is not said."""
    assert finding.link is not None
    shares = finding.link.shares
    place = finding.place
    return float(shares[place]) if place < len(shares) else float(finding.link.gain)
