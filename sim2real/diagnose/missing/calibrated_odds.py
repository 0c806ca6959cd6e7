"""Calibrated probabilities of a joint's findings, by logistic curves over measured features.

``odds_features`` measures the features, for the diagnosis and for
``benchmarks/calibrate_decisions.py``. Their weights are in ``decision.json``; they were fitted to
development cases whose truth is known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
    """Features of the curves, for one joint.

    Attributes:
        groups: Groups of effects, each with the features of the curve "effect".
        whole: Features of the curves "mismatch" and "uncatalogued".
        link: Features of the curve "link"; None where the command timing is regular.
    """

    groups: tuple[tuple[Group, Features], ...]
    whole: Features
    link: Features | None


def _logarithm(low: float, high: float) -> Callable[[float], float]:
    return lambda x: float(np.log(np.clip(x, low, high)))


_SCALES: Mapping[str, Callable[[float], float]] = {
    "probability": lambda p: -_logarithm(1e-3, 1e3)(1 / np.clip(p, 0.02, 0.98) - 1),
    "error_change": lambda x: _logarithm(3e-3, 1.0)(max(x, 0.0)) if x < 1e6 else 0.0,
    "uncatalogued_lead": lambda x: float(np.clip(x, -60.0, 60.0)) / 20.0,
    "irregularity": _logarithm(1e-2, 30.0),
    "remaining_gain": _logarithm(0.3, 30.0),
    **dict.fromkeys(("error", "error_plain"), _logarithm(1.0, 30.0)),
    **dict.fromkeys(("excess", "excess_plain"), _logarithm(0.7, 30.0)),
    **dict.fromkeys(
        ("evidence", "smooth_evidence", "windows_evidence", "named_evidence", "gain"),
        lambda x: float(np.log1p(np.clip(x, 0.0, 1e5))),
    ),
}
"""Transformation of each measure before it is weighted; identity for all others."""

_JOINT_FEATURES = ("excess_plain", "error_plain", "error")
"""Features of the joint that the curve "effect" has too."""


def scaled(**measured: float) -> Features:
    """Transformed measures, and the constant of the intercept."""
    return {"intercept": 1.0} | {name: _SCALES.get(name, float)(x) for name, x in measured.items()}


def odds_features(finding: Finding, unseen: Mapping[Set, Unseen]) -> OddsFeatures:
    """The features of all findings of a joint."""
    tried, best, link, without = finding.tried, finding.best, finding.link, finding.unmodelled
    no_findings = {ROUNDING, link.effect if link is not None else ROUNDING}
    groups = [g for g in finding.groups if no_findings.isdisjoint(g.members)]
    smooth = without.smooth.evidence(float(best.fit.count[0]))
    # Evidence by which a smooth function, which names no effect, exceeds the best set.
    lead = smooth - (best.evidence - tried.plain.evidence)
    gain, limit = finding.search.remaining_gain(tried, best.members)
    # Effects of the best set that no group states are no findings.
    servo = tried.tried.get(best.members - (finding.effects - tried.base), tried.plain)
    plain, enriched = unseen.get(tried.base), unseen.get(best.members)
    more = max(without.excess - 1, 0.0)
    explained = np.clip((without.excess - finding.excess) / more, 0, 1) if more > 0.02 else 0.5
    whole = scaled(
        excess_plain=without.excess,
        excess=finding.excess,
        explained_share=explained,
        smooth_evidence=smooth,
        windows_evidence=without.windows_evidence,
        uncatalogued_lead=lead,
        named_evidence=best.evidence - servo.evidence,
        remaining_gain=gain / max(limit, 1e-9),
        groups=len(groups),
        error_plain=1.0 if plain is None else plain.rmse / finding.noise,
        error=1.0 if enriched is None else enriched.rmse / finding.noise,
    )
    of_joint = {f"joint {name}": whole[name] for name in _JOINT_FEATURES}
    of_groups = []
    for group in groups:
        head = group.members[0]
        fewer = tried.tried.get(best.members - {head}, tried.plain)
        features = scaled(
            probability=group.probability,
            evidence=best.evidence - fewer.evidence,
            error_change=finding.changes(unseen, head),
            groups=len(groups) - 1,
            excess=finding.excess,
            uncatalogued_lead=lead,
        )
        of_groups.append((group, features | of_joint))
    of_link = None
    if link is not None:
        of_link = scaled(
            gain=link.gain,
            joints_share=float(np.mean([x > 0 for x in link.shares])),
            excess=finding.excess,
            irregularity=finding.irregularity,
            single_joint=len(link.shares) == 1,
        )
    return OddsFeatures(tuple(of_groups), whole, of_link)


def judged_together(
    findings: Sequence[Finding], unseen: Sequence[Mapping[Set, Unseen]]
) -> list[Finding]:
    """The findings of one robot's joints, see ``judged``; its link is as likely on all of them."""
    pairs = list(zip(findings, unseen, strict=True))
    on_link = [f.link is not None and len(f.link.shares) > 1 for f in findings]
    odds = [
        _link_probability(odds_features(*pair))
        for pair, shared in zip(pairs, on_link, strict=True)
        if shared
    ]
    likeliest = max(odds, default=0.0)
    return [
        judged(*pair, link_probability=likeliest if shared else 0.0)
        for pair, shared in zip(pairs, on_link, strict=True)
    ]


def _link_probability(features: OddsFeatures) -> float:
    """Probability of irregular command timing by its curve; 0 where the timing is regular."""
    return 0.0 if features.link is None else ODDS["link"].probability(features.link)


def _without_link(whole: Features, finding: Finding) -> Features:
    """Features of a joint, of what is left by irregular command timing.

    No model predicts when set-points are lost or late on another recording, so that the held-out
    error and the segments with a mismatch tell nothing of physics outside the catalogue.
    """
    error = float(np.sqrt(max(finding.excess, 1.0)))
    left = scaled(
        excess_plain=finding.excess, error_plain=error, error=error, uncatalogued_lead=0.0,
        smooth_evidence=0.0, windows_evidence=0.0,
    )  # fmt: skip
    return whole | left


def judged(
    finding: Finding, unseen: Mapping[Set, Unseen], *, link_probability: float = 0.0
) -> Finding:
    """The finding with calibrated probabilities, verdict and what stays unexplained.

    An effect whose interval includes 0 is not named, whatever its evidence; nor is a nuisance that
    every sensor has a little of, here larger than usual.

    Args:
        finding: What was found on the joint.
        unseen: Errors on held-out data by set of effects.
        link_probability: Probability of the link's effect as other joints show it.
    """
    features = odds_features(finding, unseen)
    link_probability = max(link_probability, _link_probability(features))
    named_link = link_probability >= DECISION.named
    whole = _without_link(features.whole, finding) if named_link else features.whole
    unknown = ODDS["uncatalogued"].probability(whole)
    if any(named(g.members[0]).never_named for g, _ in features.groups):
        unknown = max(unknown, DECISION.uncatalogued_probability)

    def stated(if_known: float) -> float:
        """Probability that the catalogue has what is missing, and that it is this effect."""
        probability = (1 - unknown) * if_known
        # Names stated with 0.9 and more must be right that often.
        certain = probability >= DECISION.min_certain_probability
        return probability if certain else min(probability, DECISION.max_uncertain_probability)

    groups = [
        replace(g, probability=stated(ODDS["effect"].probability(of_name)))
        for g, of_name in features.groups
        if not named(g.members[0]).never_named
        and not includes_zero(finding.tried, finding.best, g.members[0])
    ]
    coarse = [g for g in finding.groups if g.members == (ROUNDING,)]
    if finding.link is not None:
        groups.append(Group((finding.link.effect,), stated(link_probability), 1.0))
    likely = [g for g in groups if g.probability >= DECISION.named]
    matters = [g for g in likely if finding.changes(unseen, g.members[0]) >= DECISION.negligible]
    misfit = ODDS["mismatch"].probability(whole) >= DECISION.mismatch_probability
    # Negligible effects do not explain a residual that is structured without them.
    negligible = not matters and finding.excess > DECISION.structured_excess
    unsolved = misfit and not coarse and (not likely or negligible)
    return replace(
        finding,
        mismatch=bool(coarse or matters) or misfit or unknown > DECISION.named,
        groups=tuple(sorted([*coarse, *groups], key=lambda g: -g.probability)),
        unexplained=unknown > DECISION.named or unsolved,
        unknown=unknown,
    )
