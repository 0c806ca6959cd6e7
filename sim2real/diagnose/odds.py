"""What speaks for and against a finding, and how much each counts: read off cases of known answer.

Three logistic curves of ``decision.json``: of an effect that was named, of something that has no
name, of an uneven link. What they look at is made here, for the diagnosis and for
``benchmarks/calibrate_decisions.py`` alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

_LARGEST = 40.0


@dataclass(frozen=True)
class Odds:
    """A logistic curve: the log odds are the sum of features times their weights.

    Attributes:
        weights: By feature; that of one the curve does not know is 0.
    """

    weights: Mapping[str, float]

    def probability(self, features: Mapping[str, float]) -> float:
        """That it is so."""
        odds = sum(self.weights.get(name, 0.0) * value for name, value in features.items())
        return float(1 / (1 + np.exp(-np.clip(odds, -_LARGEST, _LARGEST))))


def _log(x: float, low: float, high: float) -> float:
    return float(np.log(np.clip(x, low, high)))


def of_effect(
    effect: str,
    *,
    probability: float,
    stability: float,
    alone: float,
    without: float | None,
    changes: float,
    place: int,
    groups: int,
    members: int,
    excess: float,
    lead: float,
    left: float,
) -> dict[str, float]:
    """What speaks for an effect.

    Args:
        effect: Its identifier.
        probability: Of its group, among the sets that were tried.
        stability: Share of bootstraps in which it came first.
        alone: Evidence of it alone, over the plain servo's.
        without: Evidence that the best set loses without it; None where that was not tried.
        changes: Share of the held-out error that it takes away; infinite where nobody can tell.
        place: How many others explain more.
        groups: How many groups the joint has.
        members: How many effects it may be.
        excess: Energy that the best set leaves beyond noise, in variances of the noise.
        lead: Evidence by which a function without a name is ahead of the best set.
        left: Largest gain of what might still join, relative to what chance makes.
    """
    told = bool(np.isfinite(changes)) and changes < 1e6
    return {
        "one": 1.0,
        "probability": -_log(1 / np.clip(probability, 0.02, 0.98) - 1, 1e-3, 1e3),
        "stability": stability,
        "alone": float(np.log1p(np.clip(alone, 0.0, 1e5))),
        "without": float(np.log1p(np.clip(alone if without is None else without, 0.0, 1e5))),
        "changes": _log(max(changes, 0.0), 3e-3, 1.0) if told else 0.0,
        "untold": 0.0 if told else 1.0,
        "second": float(place == 1),
        "later": float(place > 1),
        "groups": float(groups - 1),
        "members": float(np.log(members)),
        "excess": _log(excess, 0.7, 30.0),
        "lead": float(np.clip(lead, -60.0, 60.0)) / 20.0,
        "left": _log(left, 0.3, 30.0),
        f"is {effect}": 1.0,
    }


def of_nameless(
    *,
    excess_plain: float,
    excess: float,
    smooth: float,
    windows: float,
    lead: float,
    own: float,
    left: float,
    change: float,
) -> dict[str, float]:
    """What speaks for something that has no name.

    Args:
        excess_plain: Energy that the plain servo leaves beyond noise, in variances of the noise.
        excess: What the best set leaves.
        smooth: Evidence of the best smooth function of one state.
        windows: Evidence of something that acts at times.
        lead: Evidence by which the smooth function is ahead of the best set.
        own: Evidence of the best set over the plain servo's.
        left: Largest gain of what might still join the best set, relative to what chance makes.
        change: Share of the held-out error that the best set takes away.
    """
    more = max(excess_plain - 1, 0.0)
    explained = np.clip((excess_plain - excess) / more, 0.0, 1.0) if more > 0.02 else 0.5
    return {
        "one": 1.0,
        "excess_plain": _log(excess_plain, 0.7, 30.0),
        "excess": _log(excess, 0.7, 30.0),
        "explained": float(explained),
        "smooth": float(np.log1p(np.clip(smooth, 0.0, 1e5))),
        "windows": float(np.log1p(np.clip(windows, 0.0, 1e5))),
        "lead": float(np.clip(lead, -60.0, 60.0)) / 20.0,
        "own": float(np.log1p(np.clip(own, 0.0, 1e5))),
        "left": _log(left, 0.3, 30.0),
        "change": float(np.clip(change, -0.5, 1.0)),
    }


def of_link(
    *, gain: float, showing: float, worst: float, size: float, joints: int
) -> dict[str, float]:
    """What speaks for an uneven link.

    Args:
        gain: Log-likelihood that it gains.
        showing: Share of the joints that it shows on.
        worst: Largest excess of a joint, in variances of the noise.
        size: How far it turns a set-point, in noises.
        joints: How many joints there are.
    """
    return {
        "one": 1.0,
        "gain": float(np.log1p(np.clip(gain, 0.0, 1e5))),
        "showing": showing,
        "excess": _log(worst, 0.7, 30.0),
        "size": _log(size, 1e-2, 30.0),
        "alone": float(joints == 1),
    }
