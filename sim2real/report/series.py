"""Preparation of time series for plots: gaps, thinning, the largest movement."""

from __future__ import annotations

import numpy as np

from sim2real.arrays import Array, Index, Mask

GAP_INTERVALS = 3.0
LONGEST = 4000
_BINS = 1500


def gaps(t: Array) -> Index:
    """Indices of samples more than three median intervals after the previous one."""
    interval = np.diff(t)
    if not interval.size:
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(interval > GAP_INTERVALS * np.median(interval)) + 1


def drawable(t: Array, values: Array) -> tuple[Array, Array]:
    """``values (T,)`` over ``t (T,)`` with a NaN in every gap; long series are thinned.

    Of every 1/1500 of a long series, the smallest, the largest and a missing value are kept, so
    that the plotted outline and the gaps do not change.
    """
    t, (values,) = drawable_together(t, values[None])
    return t, values


def drawable_together(t: Array, values: Array) -> tuple[Array, Array]:
    """Like ``drawable``, for K series on one time axis: ``values (K, T)`` over ``t (T,)``."""
    starts = gaps(t)
    if starts.size:  # a sample is valid for one interval: a step line ends there
        t = np.insert(t, starts, t[starts - 1] + np.median(np.diff(t)))
    values = np.insert(values, starts, np.nan, axis=1)
    if t.size <= LONGEST:
        return t, values
    chosen = [_extremes(i, series) for series in values for i in _bins(t.size)]
    indices = np.unique(np.concatenate(chosen))
    return t[indices], values[:, indices]


def isolated_samples(values: Array) -> Mask:
    """Mask of ``values`` between two missing ones, which a line would not show."""
    missing = np.concatenate([[True], np.isnan(values), [True]])
    isolated: Mask = ~missing[1:-1] & missing[:-2] & missing[2:]
    return isolated


def segments(mask: Mask) -> list[tuple[int, int]]:
    """First and last index of every run of True in ``mask (T,)``."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(int(a), int(b) - 1) for a, b in zip(starts, stops, strict=True)]


def largest_move(
    t: Array, command: Array, position: Array, *, window_s: float = 1.5, lead_s: float = 0.2
) -> tuple[float, float]:
    """Start and end of a window that begins ``lead_s`` before the largest movement.

    The movement is that of the command (of the position, if no commands were recorded) in windows
    of which most samples were measured.
    """
    moving = command if np.isfinite(command).any() else position
    latest = max(t[0], t[-1] - window_s)
    ahead = np.searchsorted(t, t + lead_s).clip(max=t.size - 1)
    move = np.nan_to_num(np.abs(moving[ahead] - moving), nan=0.0)
    measured = np.concatenate([[0], np.cumsum(np.isfinite(position))])
    stop = np.searchsorted(t, t + window_s)
    expected = (np.minimum(t + window_s, t[-1]) - t) / np.median(np.diff(t))
    present = (measured[stop] - measured[:-1] > 0.8 * expected) & (t[ahead] - t < 2 * lead_s)
    move[(~present & present.any()) | (t > latest)] = -1.0
    start = float(t[np.argmax(move)])
    return start, float(min(start + window_s, t[-1]))


def _bins(size: int) -> list[Index]:
    return np.array_split(np.arange(size), _BINS)


def _extremes(indices: Index, values: Array) -> Index:
    part = values[indices]
    missing = np.isnan(part)
    chosen = [np.argmax(missing)] if missing.any() else []
    if not missing.all():
        chosen += [np.nanargmin(part), np.nanargmax(part)]
    return indices[np.array(chosen, dtype=np.intp)]
