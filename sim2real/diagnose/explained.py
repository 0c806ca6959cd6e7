"""Recordings as their references explain them, and the residuals of what may have changed.

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
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar, nnls

from sim2real.arrays import Array, Index, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.identification.problem import ServoProblem
from sim2real.inference.least_squares import OUTLIER_SD, robust_scale
from sim2real.servo.parameters import BASE, COLUMNS, LOSSES, ROTOR, beyond_load
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, Simulator
from sim2real.servo.trace import Trace

LOAD_COLUMNS = {BASE[3]: "unmodelled_inertia", BASE[4]: "gravity_load"}
"""Columns of a load in addition to the stated one, and the effects that state it."""
_BETWEEN_RUNS = {BASE[0]: 0.03, BASE[1]: 0.05, ROTOR: 0.13} | dict.fromkeys(LOSSES[1:4], 0.1)
"""Standard deviations by which parameters differ between runs of one servo, relative."""
_LATENCY_BETWEEN_RUNS_S = 0.003
_LAW_ERROR_S = 0.5
"""Time over which the error of a law persists."""

Way = Literal["repeat", "rest", "law"]


@dataclass(frozen=True)
class Changes(ServoProblem):
    """A servo's recordings, what may have changed, and what runs differ by anyway.

    Residuals are in standard deviations of the noise, of as many samples as are independent. Loads
    of rows are in addition to the stated ones; sub-steps change as little as possible, so that
    differences between servos are of physics.
    """

    weight: Array | float = 1.0  # of the residuals, 1/rad, shape (n,)
    times: Array | float = 1.0  # samples per independent sample, shape (n,)
    usual: Array | float = 1.0  # variance of the noise, rad2, shape (n,)
    count: float = 0.0  # independent samples, in the noise of the references
    trust: float = 1.0  # share of the information that counts, as more is left than in references
    along: Array | None = None  # orthonormal directions in which runs differ, shape (n, K)
    lost: Array | None = None  # share of the residual that does not count along each, shape (K,)

    @cached_property
    def simulator(self) -> Simulator:
        """Simulator of these traces, to whose loads those of servos are added."""
        return Simulator(self.traces, add_loads=True)

    def substeps(self, rows: Array, *, rough: bool = False) -> Array:
        """That of the servo itself, shorter where servos (B, P) are faster, s, (B,)."""
        # a sensor's filter may be shorter than a sample
        longest = min(LONGEST_SUBSTEP_S, min(trace.period_s for trace in self.traces) / 8)
        usual = self.simulator.substeps(self.row[None], longest_s=longest)
        return np.minimum(self.simulator.substeps(rows), usual)

    def _errors(self, rows: Array, substeps: Array) -> Array:
        errors = super()._errors(rows, substeps) * self.weight
        if self.along is None or self.lost is None:
            return errors
        return np.asarray(errors - (errors @ self.along * self.lost) @ self.along.T)

    def terms(self, x: Array) -> Array:
        """The prior's residuals; weight and inertia of another load change together."""
        parts = super().terms(x)
        if set(LOAD_COLUMNS) <= set(self.names):
            first, second = (self.names.index(name) for name in LOAD_COLUMNS)
            parts[:, first] -= parts[:, second]
            parts[:, first] *= DECISION.change.load_sd / DECISION.change.shape_sd
        return parts

    @cached_property
    def recording(self) -> Index:
        """Place of the recording of each sample, shape (n,)."""
        return np.repeat(np.arange(len(self.traces)), [int(x.used.sum()) for x in self.traces])

    @cached_property
    def error(self) -> Array:
        """What the servo itself leaves, shape (n,)."""
        return np.asarray(self.row_residuals(self.row[None])[0])

    @cached_property
    def _bare(self) -> tuple[Array, ...]:
        """The same of each recording in rad."""
        bare = replace(self, weight=1.0, along=None)
        return bare.by_trace(bare.error)

    @cached_property
    def speed(self) -> Array:
        """Of the servo itself at the used samples, rad/s, shape (n,)."""
        parts = zip(self._bare, self.traces, strict=True)
        return np.concatenate([np.gradient(e + t.position[t.used], t.t[t.used]) for e, t in parts])

    def weighted(
        self, noise: Array, inflation: Sequence[float], law_error: float = DECISION.change.law_error
    ) -> Changes:
        """The same in this ``noise`` (``noise_of``), with an inflation of each recording.

        A law is wrong by a share of what it explains, here of the error round about.
        """
        law = []
        for error, trace in zip(self._bare, self.traces, strict=True):
            samples = max(round(_LAW_ERROR_S / trace.period_s), 1)
            law.append(samples * uniform_filter1d(error**2, samples))
        times = np.asarray(inflation)[self.recording]
        usual = noise[0] + noise[1] * self.speed**2
        variance = usual * times + law_error**2 * np.concatenate(law)
        count = float(np.sum(usual / variance))
        return replace(self, weight=1 / np.sqrt(variance), times=times, usual=usual, count=count)

    def differing(self, more: Array | None = None) -> Changes:
        """The same where runs differ as usual, and by ``more`` (n, M) in one standard deviation."""
        rows = np.tile(self.row, (len(_BETWEEN_RUNS) + 2, 1))
        for row, (name, sd) in zip(rows[1:], _BETWEEN_RUNS.items(), strict=False):
            row[COLUMNS.index(name)] *= 1 + sd
        rows[-1, 2] += _LATENCY_BETWEEN_RUNS_S
        moved = replace(self, along=None).row_residuals(rows)
        moved = (moved[1:] - moved[:1]).T
        # each recording has a latency of its own
        late = moved[:, -1:] * (self.recording[:, None] == np.arange(len(self.traces)))
        parts = [moved[:, :-1], late]
        if more is not None:
            parts.append(more * np.reshape(self.weight, (-1, 1)))
        along, size, _ = np.linalg.svd(np.hstack(parts), full_matrices=False)
        return replace(self, along=along, lost=1 - 1 / np.sqrt(1 + size**2))

    def left(self, error: Array) -> tuple[float, float]:
        """Mean squares of residuals (n,), robust: in that of the noise, and of the law's error too.

        The first is of as many samples as there are.
        """
        bare = error / self.weight / np.sqrt(self.usual)
        all_in = error * np.sqrt(self.times / self.trust)
        return robust_scale(bare) ** 2, robust_scale(all_in) ** 2


def noise_of(error: Array, speed: Array, least_sd: float, *, rounds: int = 10) -> Array:
    """Variance of residuals (n,) at rest, rad2, and what a squared speed (n,) adds to it, s2.

    Times of reading jitter, so that noise grows with speed.
    """
    terms = np.stack([np.ones(error.size), speed**2], axis=1)
    noise = np.array([robust_scale(error) ** 2, 0.0])
    for _ in range(rounds):
        variance = np.maximum(terms @ noise, least_sd**2)
        limited = np.minimum(error**2, OUTLIER_SD**2 * variance)
        noise = nnls(terms / variance[:, None], limited / variance)[0]
    return np.array([max(noise[0], least_sd**2), noise[1]])


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
    def problem(self) -> Changes:
        """The recordings and the servo."""
        return Changes(self.traces, self.row, ())

    @property
    def residual(self) -> Array:
        """Measured minus explained angles of all recordings in turn, rad, shape (n,)."""
        return -self.problem.error

    @property
    def case(self) -> Mask:
        """Samples of the recordings in question, shape (n,)."""
        return np.asarray(self.problem.recording >= self.references)


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
    row[3:5] = 0.0
    mates = [tuple(q for q in range(R) if q != r) for r in range(len(traces))]
    errors = _law_errors(traces, row)
    shared = [np.zeros(error.size) for error in errors]
    if way == "rest":
        differences, spread2 = beside_rest(traces, R, step_rad)
        least = float(np.sqrt(max(spread2, step_rad**2 / 12)))
        shared = [error - x for error, x in zip(errors, differences, strict=True)]
    elif way == "repeat":
        shared, mates = _in_common(traces, errors, R)
        if not np.isfinite(np.concatenate(shared[:R])).any():  # each has a command of its own
            least = 2 * max(trace.noise_floor_rad for trace in traces[:R])
    freed = tuple(
        replace(t, position=t.position - more, used=np.isfinite(error - more))
        for t, more, error in zip(traces, shared, errors, strict=True)
    )
    return Explained(way, freed, R, row, least, tuple(mates))


def _law_errors(traces: Sequence[Trace], row: Array) -> list[Array]:
    """Measured minus simulated angles, NaN soon after the beginning and after gaps, rad."""
    total = traces[0].load.inertia_kgm2 + float(beyond_load(row))
    kp, kd, latency = (float(x) for x in row[:3])
    rate = np.real((kd - np.sqrt(complex(kd**2 - 4 * kp * total))) / (2 * total))
    # What was sent before the one and in the other is unknown: samples count once the servo has
    # forgotten all but e^-12 of it, six of a million.
    memory_s = float(np.clip(latency + 12 / max(rate, 1e-9), 0.05, 0.4))
    full = [replace(trace, used=np.ones(trace.t.size, dtype=bool)) for trace in traces]
    problem, errors = Changes(full, row, ()), []
    for trace, error in zip(traces, problem.by_trace(-problem.error), strict=True):
        apart = np.diff(trace.t, prepend=trace.t[0])
        gap = apart > 1.5 * float(np.median(apart[1:]))
        last = np.maximum.accumulate(np.where(gap, np.arange(gap.size), 0))
        counts = trace.used & (trace.t - trace.t[last] > memory_s)
        errors.append(np.where(counts, error, np.nan))
    return errors


def _in_common(
    traces: Sequence[Trace], errors: Sequence[Array], references: int
) -> tuple[list[Array], list[tuple[int, ...]]]:
    """By recording the mean error (T,) of other references with its command, and their places.

    Physics that a law lacks is in both recordings of one command, and not in their difference. The
    mean is NaN at times that no such reference covers.
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


def alignment(trace: Trace, other: Trace) -> tuple[float, float]:
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
    lags = np.linspace(-largest, largest, 61)
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
    settling = int(DECISION.change.settling_samples)
    recent = np.convolve(change != 0, np.ones(settling + 1))[: change.size] > 0
    steps = np.abs(np.diff(trace.position))
    quiet = steps < DECISION.change.rest_steps * max(step_rad, 1e-9)
    still = trace.used & ~recent & np.append(True, quiet) & np.append(quiet, True)
    still[:settling] = False
    last = np.maximum.accumulate(np.where(change != 0, np.arange(change.size), 0))
    grid, at = DECISION.change.same_set_point_rad, np.flatnonzero(still)
    return at, np.round(trace.command[at] / grid) * grid, np.sign(change[last[at]])
