"""Which effects the enriched model keeps: not those that are negligible and predict no better."""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.investigate import Finding
from sim2real.identification.held_out import Unseen
from sim2real.identification.servo_problem import Hypothesis, Set


def simpler(finding: Finding, rich: Hypothesis, unseen: Mapping[Set, Unseen]) -> Set:
    """The effects of a servo without the negligible ones; all of them where that was not tried.

    Args:
        finding: What the joint is missing.
        rich: The servo with what was found.
        unseen: Errors on held-out data, by set of effects.
    """
    added = rich.members - finding.tried.base
    negligible = {e for e in added if finding.changes(unseen, e) < DECISION.negligible}
    fewer = rich.members - negligible
    return fewer if fewer in finding.tried.tried else rich.members


def offer(
    finding: Finding, rich: Hypothesis, fewer: Set, unseen: Mapping[Set, Unseen]
) -> Hypothesis:
    """The servo of the enriched model: the one with fewer effects, unless more predict better.

    Args:
        finding: What the joint is missing.
        rich: The servo with what was found.
        fewer: Its effects that are not negligible.
        unseen: Errors on held-out data, by set of effects; of both.
    """
    less, more = unseen.get(fewer), unseen.get(rich.members)
    if (
        less is None
        or more is None
        or more.rmse < (1 - DECISION.predictor.min_improvement) * less.rmse
    ):
        return rich
    return finding.tried.tried[fewer]
