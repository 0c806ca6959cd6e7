"""Recordings of one command: what they share is no difference between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from sim2real.diagnose.decision import DECISION
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


def freed_of_the_common(
    traces: Sequence[Trace], residuals: Sequence[Array], references: int
) -> tuple[list[Trace], NDArray[np.bool_]]:
    """Traces less what a servo leaves of other references with the same command.

    Where a recording was taken twice, the difference of the two knows no missing physics that is in
    both: their repeatability decides what can be told, not the model.

    Args:
        traces: The recordings of one joint, the references first.
        residuals: Simulated minus measured angles of a servo on each, rad.
        references: How many are references.

    Returns:
        The traces, with angles corrected by the mean of what is left of those, NaN at times that
        none of those has, and which of the traces have any.
    """
    freed = list(traces)
    for r, one in enumerate(traces):
        common = []
        for other, left in zip(traces[:references], residuals, strict=False):
            if other is one:
                continue
            lag, difference = alignment(one, other)
            if difference < DECISION.change.same_command:
                seen = other.used
                when, known = one.t + lag, other.t[seen]
                part = np.interp(when, known, left[: seen.size][seen], np.nan, np.nan)
                common.append(part)
        if common:
            there = np.isfinite(common)
            mean = np.where(there, common, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
            mean[~there.any(axis=0)] = np.nan
            freed[r] = replace(one, position=one.position + mean)
    return freed, np.array([new is not old for new, old in zip(freed, traces, strict=True)])


def alignment(one: Trace, other: Trace, *, lags_tried: int = 61) -> tuple[float, float]:
    """How much later the other's command comes, s, and what then differs.

    Returns:
        The lag, and the root mean square difference of the two commands in standard deviations of
        the first.
    """
    size = float(np.std(one.command))
    if size == 0:
        return 0.0, np.inf

    def difference(lag: float) -> float:
        inside = (one.t + lag >= other.t[0]) & (one.t + lag <= other.t[-1])
        if inside.mean() < DECISION.change.same_command_overlap:
            return float("inf")
        moved = np.interp(one.t[inside] + lag, other.t, other.command) - one.command[inside]
        return float(np.sqrt(np.mean(moved**2))) / size

    lags = np.linspace(
        -DECISION.change.same_command_lag_s, DECISION.change.same_command_lag_s, lags_tried
    )
    coarse = [difference(float(lag)) for lag in lags]
    k, step = int(np.argmin(coarse)), float(lags[1] - lags[0])
    if not np.isfinite(coarse[k]):
        return 0.0, np.inf
    ends = (float(lags[k]) - step, float(lags[k]) + step)
    fine = minimize_scalar(difference, bounds=ends, method="bounded", options={"xatol": 1e-5})
    if fine.fun < coarse[k]:
        return float(fine.x), float(fine.fun)
    return float(lags[k]), coarse[k]


def unit(law: bool, scale2: float, left: Array) -> Array:
    """What null sizes are multiples of, rad2, shape (N,).

    Args:
        law: Whether the recordings are explained by a law.
        scale2: Mean square that is left of the references.
        left: Mean square that effects leave of the case, shape (N,).
    """
    return np.maximum(left, scale2) if law else np.full(left.shape, scale2)


def at_any_time(left: Array, moved: Array) -> Array:
    """How much directions take away from what is left of a reference, were it left at another time.

    The mean over all times, by Wiener and Khinchin's theorem.

    Args:
        left: What is left, NaN where not looked at, shape (T,).
        moved: The directions, shape (N, T); what they do where nobody looks counts for nothing.

    Returns:
        Share of what is left, shape (N,).
    """
    seen = np.isfinite(left)
    shown = np.where(seen, left, 0.0), np.where(seen, moved, 0.0)
    power, other = (np.abs(np.fft.fft(x)) ** 2 for x in shown)
    weight = power.sum() * other.sum(axis=1)
    share = np.ones(len(moved))
    np.divide(other @ power, weight, out=share, where=weight > 0)
    return share
