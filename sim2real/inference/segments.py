"""Time windows in which a residual exceeds the noise, and parts of a motion in which it is."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from sim2real.arrays import Array, Index, Mask

Window = tuple[float, float]


class MotionPart(NamedTuple):
    """A part of a motion."""

    text: str  # "72 % of it at speeds above 0.2 m/s, in 50 % of the time"
    advice: str  # what to record to learn more

    def __str__(self) -> str:
        """The part with its shares of squared residuals and of time."""
        return self.text


def most_uneven(
    square: Array, parts: Iterable[tuple[str, Mask, str]], *, least: float = 0.1
) -> MotionPart | None:
    """The part whose share of squared residuals (T,) is furthest above its share of time.

    Parts are given by their words, samples and advice; None if none is ``least`` above it.
    Shares are compared by their relative entropy (Kullback and Leibler, Ann. Math. Stat. 22 (1951)
    79); 0.1 is that of 72 % of the squared residuals in half of the time.
    """
    found: dict[float, MotionPart] = {}
    total = max(float(square.sum()), 1e-30)
    for words, mask, advice in parts:
        p, q = float(square[mask].sum()) / total, float(mask.mean())
        if p > q > 0:
            rest = (1 - p) * np.log((1 - p) / (1 - q)) if p < 1 else 0.0
            text = f"{100 * p:.0f} % of it {words}, in {100 * q:.0f} % of the time"
            found[p * np.log(p / q) + rest] = MotionPart(text, advice)
    most = max(found, default=0.0)
    return found[most] if most >= least else None


def robust_sd(residual: Array, inside: Mask) -> float:
    """Standard deviation of the residual outside windows, from its median absolute deviation."""
    outside = residual[~inside & np.isfinite(residual)]
    if outside.size < 10:
        outside = residual[np.isfinite(residual)]
    return float(np.median(np.abs(outside)) / 0.6745)


def windows(
    t: Array, residual: Array, sd: float, *, larger: float = 5.0, shortest_s: float = 0.1
) -> tuple[Window, ...]:
    """Beginning and end in s of windows in which the residual (T,) exceeds its noise ``sd``.

    The most likely path of a hidden Markov model with a quiet and a loud state (Viterbi, IEEE
    Transactions on Information Theory 13 (1967) 260-269), in which the standard deviation is
    ``larger`` times that outside. A residual is NaN where none is known.
    """
    z2 = np.where(np.isfinite(residual), (residual / sd) ** 2, 0.0)
    score = 0.5 * z2 * (1 - larger**-2) - np.log(larger)
    segments = [(float(t[a]), float(t[b - 1])) for a, b in runs(_most_likely_path(score))]
    return tuple((a, b) for a, b in segments if b - a >= shortest_s)


def runs(mask: Mask) -> Index:
    """First index of every run of True in a mask (T,), and that after its last, shape (N, 2)."""
    return np.flatnonzero(np.diff(np.r_[False, mask, False].astype(np.int8))).reshape(-1, 2)


def inside(t: Array, windows: tuple[Window, ...]) -> Mask:
    """Mask of the times that lie in one of the windows, shape (T,)."""
    mask = np.zeros(t.size, dtype=bool)
    for begin, end in windows:
        mask |= (t >= begin) & (t <= end)
    return mask


def _most_likely_path(score: Array, edge_cost: float = 12.0) -> Mask:
    """Whether the most likely state is the loud one, from log-likelihood ratios (T,)."""
    quiet, loud = 0.0, -edge_cost
    from_loud, from_quiet = (np.zeros(score.size, dtype=bool) for _ in range(2))
    for k, x in enumerate(score.tolist()):
        from_loud[k] = loud - edge_cost > quiet
        from_quiet[k] = quiet - edge_cost > loud
        quiet, loud = max(quiet, loud - edge_cost), max(loud, quiet - edge_cost) + x
    state, path = loud - edge_cost > quiet, np.zeros(score.size, dtype=bool)
    for k in range(score.size - 1, -1, -1):
        path[k] = state
        state = not from_quiet[k] if state else from_loud[k]
    return path
