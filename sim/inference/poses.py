"""What a camera's poses say of themselves, whatever the robot does: lost frames, smoothed noise."""

from __future__ import annotations

from collections.abc import Sequence

from sim.inference.swims import Swim

_EACH, _SURELY = 3.0, 600.0
"""Evidence of one repeated pose, and the most that they may bring."""


def repeated(swims: Sequence[Swim]) -> float:
    """Share of poses that repeat the one before to the last digit: frames that were lost."""
    return max(swim.repeated for swim in swims)


def repeated_variance(swims: Sequence[Swim]) -> float:
    """Of that share, as a count tells it."""
    n, share = sum(swim.t.size for swim in swims), repeated(swims)
    return (share * (1 - share) + 1 / n) / n


def counted(swims: Sequence[Swim], *, lost: bool) -> float:
    """Evidence of the count, where frames are ``lost`` or not: noise never repeats a pose."""
    often = min(repeated(swims) * sum(swim.t.size for swim in swims) * _EACH, _SURELY)
    return (often if lost else 0.0) if often > _EACH else (-_SURELY if lost else 0.0)


def coloured(swims: Sequence[Swim], lag_s: float) -> float:
    """Evidence of the colour of the poses' noise: a filter smooths that as well."""
    return sum(s.shaken.told(lag_s) for s in swims if s.shaken is not None and lag_s > 0)


__all__ = ["coloured", "counted", "repeated", "repeated_variance"]
