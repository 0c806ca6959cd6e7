"""Recordings as their references explain them.

The prediction of an unchanged recording is that of the references' law, plus, where references have
the same command (``repeat``), the mean of what the law leaves of them. Servos that are sampled
slowly are compared with the angles at which the references came to rest (``rest``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar

from sim2real.arrays import Array, Index, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.identification.problem import ServoProblem
from sim2real.servo.parameters import BASE, beyond_load
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, Simulator
from sim2real.servo.trace import Trace

Way = Literal["repeat", "rest", "law"]


class SameSteps(ServoProblem):
    """A servo to be compared with another one of other parameters.

    Loads of rows are in addition to those that are stated. Sub-steps change as little as possible,
    so that differences are of physics.
    """

    @cached_property
    def simulator(self) -> Simulator:
        """Simulator of these traces, to whose loads those of servos are added."""
        return Simulator(self.traces, add_loads=True)

    @cached_property
    def _usual(self) -> float:
        """Sub-step of the servo itself; a sensor's filter may be shorter than a sample."""
        longest = min(LONGEST_SUBSTEP_S, min(trace.period_s for trace in self.traces) / 8)
        return float(self.simulator.substeps(self.row[None], longest_s=longest)[0])

    def substeps(self, rows: Array, *, rough: bool = False) -> Array:
        """That of the servo itself, shorter where servos (B, P) are faster, s, (B,)."""
        return np.minimum(self.simulator.substeps(rows), self._usual)


@dataclass(frozen=True)
class Explained:
    """Recordings of a joint, the references first, and their residuals at n samples."""

    way: Way  # how they are explained
    # the recordings less what references say that the law misses; what is looked at is ``used``
    traces: tuple[Trace, ...]
    references: int  # number of references
    row: Array  # parameters of the references' servo, its load 0 in addition, shape (P,)
    least_sd: float  # smallest standard deviation that a residual may have, rad
    mates: tuple[tuple[int, ...], ...]  # of each recording the references like it, all or none

    @cached_property
    def residual(self) -> Array:
        """Measured minus explained angles of all recordings in turn, rad, shape (n,)."""
        errors = SameSteps(self.traces, self.row, ()).row_residuals(self.row[None])
        return np.asarray(-errors[0])

    @cached_property
    def recording(self) -> Index:
        """Place of the recording of each sample, shape (n,)."""
        counts = [int(trace.used.sum()) for trace in self.traces]
        return np.repeat(np.arange(len(counts)), counts)

    @property
    def case(self) -> Mask:
        """Samples of the recordings in question, shape (n,)."""
        return np.asarray(self.recording >= self.references)


def way_of(references: Sequence[Trace], case: Sequence[Trace]) -> Way:
    """How a case is best compared with its references."""
    steps = np.concatenate([np.diff(trace.t) for trace in (*references, *case)])
    if float(np.median(steps)) > DECISION.change.slow_sampling_s:
        return "rest"
    limit = DECISION.change.same_command
    repeats = (any(alignment(trace, other)[1] < limit for other in references) for trace in case)
    return "repeat" if all(repeats) else "law"


def explained(
    references: Sequence[Trace], case: Sequence[Trace], row: Array, step_rad: float
) -> Explained:
    """Explain recordings of a joint by its references, and by a servo of a row (P,).

    ``step_rad`` is the step of its sensor.
    """
    traces, R = [*references, *case], len(references)
    way, least = way_of(references, case), 1e-9
    row = row.copy()
    row[BASE.index("inertia_kgm2") : BASE.index("gravity_Nm") + 1] = 0.0
    mates = [tuple(q for q in range(R) if q != r) for r in range(len(traces))]
    errors = _law_errors(traces, row)
    if way == "rest":
        differences, spread2 = beside_rest(traces, R, step_rad)
        least = float(np.sqrt(max(spread2, step_rad**2 / 12)))
        shared = [error - x for error, x in zip(errors, differences, strict=True)]
    elif way == "repeat":
        shared, mates = in_common(traces, errors, R)
        if not np.isfinite(np.concatenate(shared[:R])).any():  # each has a command of its own
            least = 2 * max(trace.noise_floor_rad for trace in traces[:R])
    else:
        shared = [np.zeros(error.size) for error in errors]
    freed = tuple(
        replace(t, position=t.position - more, used=np.isfinite(error - more))
        for t, more, error in zip(traces, shared, errors, strict=True)
    )
    return Explained(way, freed, R, row, least, tuple(mates))


def _law_errors(
    traces: Sequence[Trace], row: Array, *, limits_s: tuple[float, float] = (0.05, 0.4)
) -> list[Array]:
    """Measured minus simulated angles, NaN soon after the beginning and after gaps, rad.

    What was sent before the one and in the other is unknown: samples count once the servo has
    forgotten all but e^-12 of it, six of a million.
    """
    total = traces[0].load.inertia_kgm2 + float(beyond_load(row))
    kp, kd, latency = (float(x) for x in row[:3])
    rate = np.real((kd - np.sqrt(complex(kd**2 - 4 * kp * total))) / (2 * total))
    memory_s = float(np.clip(latency + 12 / max(rate, 1e-9), *limits_s))
    errors = []
    full = [replace(trace, used=np.ones(trace.t.size, dtype=bool)) for trace in traces]
    problem = SameSteps(full, row, ())
    parts = problem.by_trace(-problem.row_residuals(row[None])[0])
    for trace, error in zip(traces, parts, strict=True):
        apart = np.diff(trace.t, prepend=trace.t[0])
        gap = apart > 1.5 * float(np.median(apart[1:]))
        last = np.maximum.accumulate(np.where(gap, np.arange(gap.size), 0))
        counts = trace.used & (trace.t - trace.t[last] > memory_s)
        errors.append(np.where(counts, error, np.nan))
    return errors


def in_common(
    traces: Sequence[Trace], errors: Sequence[Array], references: int
) -> tuple[list[Array], list[tuple[int, ...]]]:
    """What the law leaves (T,) of other references with the command of each recording, rad.

    Physics that a law lacks is in both recordings of one command, and not in their difference.
    ``errors`` are measured minus simulated angles, the references first, NaN where unknown.

    Returns:
        For each recording the mean over these references, NaN at times that none covers, and the
        places of these.
    """
    shared, mates = [], []
    for trace in traces:
        common, mine = [], []
        for q, (other, error) in enumerate(zip(traces[:references], errors, strict=False)):
            lag, difference = (0.0, np.inf) if other is trace else alignment(trace, other)
            if difference < DECISION.change.same_command:
                mine.append(q)
                there = np.isfinite(error)
                pair = other.t[there], error[there]
                common.append(np.interp(trace.t + lag, *pair, np.nan, np.nan))
        known = [*common, np.full(trace.t.size, np.nan)]
        shared.append(np.ma.masked_invalid(known).mean(axis=0).filled(np.nan))
        mates.append(tuple(mine))
    return shared, mates


def alignment(trace: Trace, other: Trace, *, lags_tried: int = 61) -> tuple[float, float]:
    """How much later the other's command comes, s, and how far both then differ.

    The difference is a root mean square, in standard deviations of the first command.
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
    coarse, lag = min((difference(float(lag)), float(lag)) for lag in lags)
    if not np.isfinite(coarse):
        return 0.0, np.inf
    step = float(lags[1] - lags[0])
    ends = (lag - step, lag + step)
    fine = minimize_scalar(difference, bounds=ends, method="bounded", options={"xatol": 1e-5})
    return (float(fine.x), float(fine.fun)) if fine.fun < coarse else (lag, coarse)


def beside_rest(
    traces: Sequence[Trace], references: int, step_rad: float
) -> tuple[list[Array], float]:
    """Angles less those at which the references came to rest, in rad.

    Returns:
        For each recording the difference from the mean of the other references after the same
        set-point and from the same side, NaN in motion and where no reference rested, shape (T,);
        and the mean square by which angles of one reference differ after one set-point, rad2.
    """
    rests = [_rests(trace, step_rad) for trace in traces]
    grid, differences, spread = DECISION.change.same_set_point_rad, [], [np.zeros(0)]
    for r, (trace, (at, command, side)) in enumerate(zip(traces, rests, strict=True)):
        levels = [np.full(at.size, np.nan)]
        for q, (known, there, other_side) in enumerate(rests[:references]):
            angle, apart = traces[q].position[known], np.abs(command[:, None] - there)
            if q == r:
                same = (apart == 0) & (side[:, None] == other_side)
                spread.append(angle - same @ angle / same.sum(axis=1))
            else:
                same = (apart < 2 * grid) & (side[:, None] * other_side >= 0)
                levels.append(same @ angle / np.where(same.any(axis=1), same.sum(axis=1), np.nan))
        level = np.ma.masked_invalid(levels).mean(axis=0).filled(np.nan)
        differences.append(np.full(trace.t.size, np.nan))
        differences[-1][at] = trace.position[at] - level
    steps = np.concatenate(spread)
    return differences, float(np.mean(steps**2)) if steps.size else 0.0


def _rests(trace: Trace, step_rad: float) -> tuple[Index, Array, Array]:
    """Samples at rest, with their set-points in rad and the sides they came from, 0 if unknown."""
    change = np.diff(trace.command, prepend=trace.command[:1])
    settling = DECISION.change.settling_samples
    recent = np.convolve(change != 0, np.ones(settling + 1))[: change.size] > 0
    steps = np.abs(np.diff(trace.position))
    quiet = steps < DECISION.change.rest_steps * max(step_rad, 1e-9)
    still = trace.used & ~recent & np.append(True, quiet) & np.append(quiet, True)
    still[:settling] = False
    last = np.maximum.accumulate(np.where(change != 0, np.arange(change.size), 0))
    grid, at = DECISION.change.same_set_point_rad, np.flatnonzero(still)
    return at, np.round(trace.command[at] / grid) * grid, np.sign(change[last[at]])
