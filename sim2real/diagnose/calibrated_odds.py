"""Calibrated probabilities of a joint's findings, and the servo that its enriched model has.

The probabilities are logistic curves over measured features. ``odds_features`` measures these for
the diagnosis and for ``benchmarks/calibrate_decisions.py``, which fitted the weights of
``decision.json`` to development cases whose truth is known.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.decision import DECISION, ODDS
from sim2real.diagnose.effect_probabilities import Group
from sim2real.diagnose.investigate import ROUNDING, Finding
from sim2real.diagnose.joint_result import JointFindings, includes_zero
from sim2real.effects import named
from sim2real.identification.held_out import Unseen, held_out
from sim2real.identification.servo_problem import Hypothesis, Set

Features = dict[str, float]
Errors = Mapping[Set, Unseen]
"""Errors on held-out data, by set of effects."""


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


def scaled(**measured: float) -> Features:
    """Transformed measures, and the constant of the intercept."""
    return {"intercept": 1.0} | {name: _SCALES.get(name, float)(x) for name, x in measured.items()}


def odds_features(
    finding: Finding, unseen: Errors
) -> tuple[list[tuple[Group, Features]], Features, Features | None]:
    """The features of all findings of a joint.

    Returns:
        Groups of effects, each with the features of the curve "effect"; features of the curves
        "mismatch" and "uncatalogued"; and those of the curve "link", None where the command timing
        is regular.
    """
    tried, best, link, without = finding.tried, finding.best, finding.link, finding.unmodelled
    no_findings = {ROUNDING, *(link.sizes if link is not None else ())}
    groups = [g for g in finding.groups if no_findings.isdisjoint(g.members)]
    changes = [finding.changes(unseen, g.head) for g in groups]
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
        groups=sum(change >= DECISION.negligible for change in changes),
        error_plain=1.0 if plain is None else plain.error / finding.noise,
        error=1.0 if enriched is None else enriched.error / finding.noise,
    )
    of_joint = {f"joint {name}": whole[name] for name in ("excess_plain", "error_plain", "error")}
    of_groups = []
    for group, change in zip(groups, changes, strict=True):
        fewer = tried.tried.get(best.members - {group.head}, tried.plain)
        as_large = float(len(changes))  # groups that lower the error as much; smaller ones in part
        if np.isfinite(change) and change > 0:
            as_large = float(sum(np.clip(other / change, 0.0, 1.0) for other in changes))
        features = scaled(
            probability=group.probability,
            evidence=best.evidence - fewer.evidence,
            error_change=change,
            groups=as_large - 1,
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
    return of_groups, whole, of_link


def judged_together(findings: Sequence[Finding], unseen: Sequence[Errors]) -> list[Finding]:
    """The findings of one robot's joints, see ``judged``; its link is as likely on all of them."""
    pairs = list(zip(findings, unseen, strict=True))
    shared = [f.link is not None and len(f.link.shares) > 1 for f in findings]
    links = [odds_features(*x)[2] for x, is_shared in zip(pairs, shared, strict=True) if is_shared]
    largest = max((ODDS["link"].probability(x) for x in links if x is not None), default=0.0)
    return [
        judged(*pair, link_probability=largest if is_shared else 0.0)
        for pair, is_shared in zip(pairs, shared, strict=True)
    ]


def judged(finding: Finding, unseen: Errors, *, link_probability: float = 0.0) -> Finding:
    """The finding with calibrated probabilities, verdict and what stays unexplained.

    An effect whose interval includes 0 is not named, whatever its evidence; nor is a nuisance that
    every sensor has a little of, here larger than usual. ``link_probability`` is that of the link's
    effect as other joints show it.
    """
    of_groups, whole, of_link = odds_features(finding, unseen)
    if of_link is not None:
        link_probability = max(link_probability, ODDS["link"].probability(of_link))
    if link_probability >= DECISION.named:
        # No model predicts when set-points are lost or late on another recording, so that held-out
        # errors and segments with a mismatch tell nothing of physics outside the catalogue.
        error = float(np.sqrt(max(finding.excess, 1.0)))
        whole = whole | scaled(
            excess_plain=finding.excess, error_plain=error, error=error, uncatalogued_lead=0.0,
            smooth_evidence=0.0, windows_evidence=0.0,
        )  # fmt: skip
    unknown = ODDS["uncatalogued"].probability(whole)
    if any(named(g.head).never_named for g, _ in of_groups):
        unknown = max(unknown, DECISION.uncatalogued_probability)
    groups = [
        Group(g.members, _stated(ODDS["effect"].probability(of_name), unknown, change))
        for g, of_name in of_groups
        if not named(g.head).never_named and not includes_zero(finding.tried, finding.best, g.head)
        for change in [finding.changes(unseen, g.head)]
    ]
    if finding.link is not None:
        probability = _stated(link_probability, unknown)
        groups.extend(Group((effect,), probability) for effect in finding.link.sizes)
    coarse = [g for g in finding.groups if g.members == (ROUNDING,)]
    probable = [g for g in groups if g.probability >= DECISION.named]
    matters = any(finding.changes(unseen, g.head) >= DECISION.negligible for g in probable)
    mismatch = ODDS["mismatch"].probability(whole) >= DECISION.mismatch_probability
    rattling = finding.rattle is not None and link_probability < DECISION.named
    # Negligible effects do not explain a residual that is structured without them.
    unsolved = mismatch and not coarse and (not probable or (not matters and finding.structured))
    return replace(
        finding,
        mismatch=bool(coarse) or matters or mismatch or rattling or unknown > DECISION.named,
        groups=tuple(sorted([*coarse, *groups], key=lambda g: -g.probability)),
        unexplained=unknown > DECISION.named or unsolved or rattling,
        unknown=unknown,
    )


def _stated(if_known: float, unknown: float, change: float = 0.0) -> float:
    """Probability that the catalogue has what is missing, and that it is this effect.

    What is unknown accounts for the squared error that the effect leaves; the smaller its share of
    that without the effect, the less it can stand in for it.
    """
    remains = float(np.clip(1 - change, 0.0, 1.0)) ** 2 if np.isfinite(change) else 1.0
    probability = (1 - unknown * remains) * if_known
    # Names stated with 0.9 and more must be right that often.
    certain = probability >= DECISION.min_certain_probability
    return probability if certain else min(probability, DECISION.max_uncertain_probability)


def judged_and_offered(
    joints: Sequence[JointCase], findings: Sequence[Finding]
) -> list[JointFindings]:
    """Judge the findings of a robot by held-out errors, and choose the servos of its model.

    Findings against references are judged already: they are offered as they are named.
    """
    pairs = zip(joints, findings, strict=True)
    offered = [JointFindings(joint, one, one.best, one.best, {}) for joint, one in pairs]
    searched = [j for j, joint in enumerate(joints) if not joint.references]
    errors = [dict[Set, Unseen]() for _ in searched]
    for unseen, j in zip(errors, searched, strict=True):
        best, base = findings[j].best.members, findings[j].tried.base
        _score(unseen, offered[j], base, best, *(best - {effect} for effect in best - base))
    judged_ones = judged_together([findings[j] for j in searched], errors)
    for unseen, j, finding in zip(errors, searched, judged_ones, strict=True):
        offered[j] = _offered(replace(offered[j], finding=finding, unseen=unseen), unseen)
    return offered


def _score(unseen: dict[Set, Unseen], joint: JointFindings, *sets: Set) -> None:
    """Add the held-out errors of those sets of effects that were tried and have none yet."""
    tried = joint.finding.tried.tried
    new = [s for s in dict.fromkeys(sets) if s in tried and s not in unseen]
    scores = held_out([joint.joint.traces] * len(new), [tried[s].fit.servos for s in new])
    unseen.update((s, x) for s, x in zip(new, scores, strict=True) if x is not None)


def _offered(joint: JointFindings, unseen: dict[Set, Unseen]) -> JointFindings:
    """A judged joint with the servo of its enriched model, chosen by held-out errors."""
    finding, tried, best = joint.finding, joint.finding.tried, joint.finding.best
    heads = {g.head for g in finding.groups if g.probability >= DECISION.named}
    # what is named, and no findings as they are
    wanted = best.members - (finding.effects - heads)
    if finding.link is not None:
        wanted &= heads | {name for name in wanted if named(name).everywhere}
    enriched = tried.tried.get(tried.base | wanted, best if heads else tried.plain)
    _score(unseen, joint, enriched.members)
    less, more = unseen.get(enriched.members), unseen.get(best.members)
    # All of the most probable set may predict better than what is named of it.
    if finding.mismatch and finding.link is None and less is not None and more is not None:
        enriched = best if more.error < less.error else enriched
    fewer = simpler(finding, enriched, unseen)
    _score(unseen, joint, fewer)
    return replace(joint, enriched=enriched, offered=offer(finding, enriched, fewer, unseen))


def simpler(finding: Finding, enriched: Hypothesis, unseen: Errors) -> Set:
    """The effects of a servo without the negligible ones; all of them where that was not tried."""
    added = enriched.members - finding.tried.base
    negligible = {e for e in added if finding.changes(unseen, e) < DECISION.negligible}
    fewer = enriched.members - negligible
    return fewer if fewer in finding.tried.tried else enriched.members


def offer(finding: Finding, enriched: Hypothesis, fewer: Set, unseen: Errors) -> Hypothesis:
    """The servo of the enriched model: the one with fewer effects, unless more predict better."""
    less, more = unseen.get(fewer), unseen.get(enriched.members)
    if less is None or more is None:
        return enriched
    better = more.error < (1 - DECISION.min_improvement) * less.error
    return enriched if better else finding.tried.tried[fewer]
