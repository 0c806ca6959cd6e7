"""Comparison with references that needs no model: repeats of a command, and angles at rest.

A servo that is sampled slowly is mostly seen at rest: what such a recording shows well is the angle
at which the servo stays, given its set-point and the side from which it came.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from sim2real.arrays import Array, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.servo.trace import Trace

Rest = tuple[float, float]
"""Set-point in rad, and the side from which the servo came, 0 if unknown."""


def freed_of_the_common(
    traces: Sequence[Trace], residuals: Sequence[Array], references: int
) -> tuple[list[Trace], Mask]:
    """Traces corrected by the residuals of other references with the same command.

    Physics that a model lacks is in both recordings of one command, and not in their difference.

    Args:
        traces: The recordings of one joint, the references first.
        residuals: Simulated minus measured angles of a servo on each, rad.
        references: Number of references.

    Returns:
        The traces, with angles corrected by the mean residual of those references, NaN at times
        that none of them covers; and a mask of the traces that have such references.
    """
    freed = list(traces)
    for r, trace in enumerate(traces):
        common = []
        for other, residual in zip(traces[:references], residuals, strict=False):
            lag, difference = (0.0, np.inf) if other is trace else alignment(trace, other)
            if difference < DECISION.change.same_command:
                used = other.used
                known = other.t[used], residual[: used.size][used]
                common.append(np.interp(trace.t + lag, *known, np.nan, np.nan))
        if common:
            mean = np.ma.masked_invalid(common).mean(axis=0).filled(np.nan)
            freed[r] = replace(trace, position=trace.position + mean)
    return freed, np.array([new is not old for new, old in zip(freed, traces, strict=True)])


def alignment(trace: Trace, other: Trace, *, lags_tried: int = 61) -> tuple[float, float]:
    """Lag at which two commands agree best, and their remaining difference.

    Returns:
        How much later the other's command comes, s, and the root mean square difference of the
        commands in standard deviations of the first.
    """
    size = float(np.std(trace.command))
    if size == 0:
        return 0.0, np.inf

    def difference(lag: float) -> float:
        inside = (trace.t + lag >= other.t[0]) & (trace.t + lag <= other.t[-1])
        if inside.mean() < DECISION.change.same_command_overlap:
            return float("inf")
        moved = np.interp(trace.t[inside] + lag, other.t, other.command) - trace.command[inside]
        return float(np.sqrt(np.mean(moved**2))) / size

    largest = DECISION.change.same_command_lag_s
    lags = np.linspace(-largest, largest, lags_tried)
    coarse = [difference(float(lag)) for lag in lags]
    k, step = int(np.argmin(coarse)), float(lags[1] - lags[0])
    if not np.isfinite(coarse[k]):
        return 0.0, np.inf
    ends = (float(lags[k]) - step, float(lags[k]) + step)
    fine = minimize_scalar(difference, bounds=ends, method="bounded", options={"xatol": 1e-5})
    if fine.fun < coarse[k]:
        return float(fine.x), float(fine.fun)
    return float(lags[k]), coarse[k]


def beside_rest(
    traces: Sequence[Trace], references: int, step_rad: float
) -> tuple[list[Array], float]:
    """Angles less those at which the references came to rest, in rad.

    Args:
        traces: The recordings of one joint, the references first.
        references: Number of references.
        step_rad: Step of the joint's sensor.

    Returns:
        For each recording the difference from the mean of the other references after the same
        set-point and from the same side, NaN in motion and where no reference rested, shape (T,);
        and the mean square by which angles of one reference differ after one set-point, rad2.
    """
    rests = [_rests(trace, step_rad) for trace in traces]
    levels = []
    for trace, keys in zip(traces[:references], rests, strict=False):
        angles: defaultdict[Rest, list[float]] = defaultdict(list)
        for k, key in keys.items():
            angles[key].append(float(trace.position[k]))
        levels.append({key: np.array(values) for key, values in angles.items()})
    spread = [values - values.mean() for level in levels for values in level.values()]
    within = float(np.mean(np.concatenate(spread) ** 2)) if spread else 0.0
    differences = []
    for r, (trace, keys) in enumerate(zip(traces, rests, strict=True)):
        difference = np.full(trace.t.size, np.nan)
        for k, key in keys.items():
            same = [
                np.concatenate(values).mean()
                for q, level in enumerate(levels)
                if q != r and (values := [x for at, x in level.items() if _same_rest(at, key)])
            ]
            if same:
                difference[k] = trace.position[k] - np.mean(same)
        differences.append(difference)
    return differences, within


def _rests(trace: Trace, step_rad: float) -> dict[int, Rest]:
    """The samples of a recording that are at rest."""
    change = np.diff(trace.command, prepend=trace.command[:1])
    settling = DECISION.change.settling_samples
    recent = np.convolve(change != 0, np.ones(settling + 1))[: change.size] > 0
    steps = np.abs(np.diff(trace.position))
    quiet = steps < DECISION.change.rest_steps * max(step_rad, 1e-9)
    still = trace.used & ~recent & np.append(True, quiet) & np.append(quiet, True)
    still[:settling] = False
    last = np.maximum.accumulate(np.where(change != 0, np.arange(change.size), 0))
    grid = DECISION.change.same_set_point_rad
    command, side = np.round(trace.command / grid) * grid, np.sign(change[last])
    return {int(k): (float(command[k]), float(side[k])) for k in np.flatnonzero(still)}


def _same_rest(rest: Rest, other: Rest) -> bool:
    """Whether two rests have one set-point and sides that may be the same."""
    near = abs(rest[0] - other[0]) < 2 * DECISION.change.same_set_point_rad
    return near and rest[1] * other[1] >= 0
