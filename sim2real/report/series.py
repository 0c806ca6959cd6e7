"""Time series made ready to draw: gaps kept, long ones thinned, the largest move found."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim2real.recording import Array

GAP_INTERVALS = 3.0
LONGEST = 4000
_BINS = 1500


def gaps(t: Array) -> NDArray[np.intp]:
    """Indices of the samples that come more than three median intervals after the one before."""
    interval = np.diff(t)
    if not interval.size:
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(interval > GAP_INTERVALS * np.median(interval)) + 1


def drawable(t: Array, values: Array) -> tuple[Array, Array]:
    """``values (T,)`` over ``t (T,)`` with a NaN in every gap; thinned if there are too many.

    Of every 1/1500 of a long series the smallest and the largest value stay, and a missing one, so
    that the drawn outline is that of all samples and gaps stay gaps.
    """
    at = gaps(t)
    if at.size:  # a sample speaks for one interval: a step goes no further into the gap
        t = np.insert(t, at, t[at - 1] + np.median(np.diff(t)))
    values = np.insert(values, at, np.nan)
    if t.size <= LONGEST:
        return t, values
    kept = np.unique(np.concatenate([_extremes(i, values) for i in _bins(t.size)]))
    return t[kept], values[kept]


def lone(values: Array) -> NDArray[np.bool_]:
    """Which of ``values`` stand alone between missing ones: a line would not show them."""
    missing = np.concatenate([[True], np.isnan(values), [True]])
    alone: NDArray[np.bool_] = ~missing[1:-1] & missing[:-2] & missing[2:]
    return alone


def segments(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of every run of True in ``mask (T,)``."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(a), int(b) - 1) for a, b in zip(starts, stops, strict=True)]


def largest_move(
    t: Array, command: Array, position: Array, *, window_s: float = 1.5, lead_s: float = 0.2
) -> tuple[float, float]:
    """Start and end of the ``window_s`` seconds that begin just before the largest move.

    The move is looked for in the command (in the position, where no commands were recorded), and
    only where most of the window was measured.
    """
    moving = command if np.isfinite(command).any() else position
    last = max(t[0], t[-1] - window_s)
    ahead = np.searchsorted(t, t + lead_s).clip(max=t.size - 1)
    move = np.nan_to_num(np.abs(moving[ahead] - moving), nan=0.0)
    measured = np.concatenate([[0], np.cumsum(np.isfinite(position))])
    stop = np.searchsorted(t, t + window_s)
    expected = (np.minimum(t + window_s, t[-1]) - t) / np.median(np.diff(t))
    present = (measured[stop] - measured[:-1] > 0.8 * expected) & (t[ahead] - t < 2 * lead_s)
    move[(~present & present.any()) | (t > last)] = -1.0
    start = float(t[np.argmax(move)])
    return start, float(min(start + window_s, t[-1]))


def _bins(size: int) -> list[NDArray[np.intp]]:
    return np.array_split(np.arange(size), _BINS)


def _extremes(indices: NDArray[np.intp], values: Array) -> NDArray[np.intp]:
    part = values[indices]
    missing = np.isnan(part)
    chosen = [np.argmax(missing)] if missing.any() else []
    if not missing.all():
        chosen += [np.nanargmin(part), np.nanargmax(part)]
    return indices[np.array(chosen, dtype=np.intp)]
