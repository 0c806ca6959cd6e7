"""Evidence of camera effects from the poses alone: lost frames and filtered noise."""

from __future__ import annotations

from collections.abc import Sequence

from sim.inference.swims import Swim

_EACH, _LARGEST = 3.0, 600.0
"""Log-evidence of one repeated pose, and its largest sum."""


def repeated(swims: Sequence[Swim]) -> float:
    """Share of poses identical to the one before, which shows lost frames."""
    return max(swim.repeated for swim in swims)


def repeated_variance(swims: Sequence[Swim]) -> float:
    """Variance of that share, from its count."""
    n, share = sum(swim.t.size for swim in swims), repeated(swims)
    return (share * (1 - share) + 1 / n) / n


def counted(swims: Sequence[Swim], *, lost: bool) -> float:
    """Log-evidence of the repeated poses if frames are ``lost`` or not: noise repeats none."""
    evidence = min(repeated(swims) * sum(swim.t.size for swim in swims) * _EACH, _LARGEST)
    return (evidence if lost else 0.0) if evidence > _EACH else (-_LARGEST if lost else 0.0)


def coloured(swims: Sequence[Swim], lag_s: float) -> float:
    """Log-evidence of a filter of the poses from the spectrum of their noise."""
    return sum(
        swim.pose_noise.log_ratio(lag_s)
        for swim in swims
        if swim.pose_noise is not None and lag_s > 0
    )
