"""Recordings as their references explain them.

The prediction of an unchanged recording is, in this order, the mean residual of references with the
same command (``repeat``), where the references came to rest if the servo is sampled slowly, so that
it is mostly seen at rest (``rest``), or the servo's law with the references' parameters (``law``).
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
from sim2real.effects import CATALOGUE
from sim2real.identification.priors import motor_prior
from sim2real.identification.problem import ServoProblem
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.noise import noise_floor
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, COLUMNS, beyond_load
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, Simulator
from sim2real.servo.trace import Trace

Way = Literal["repeat", "rest", "law"]
GAINS = BASE[:3]


@dataclass(frozen=True)
class Explained:
    """Recordings of a joint, the references first, and their residuals at n samples."""

    way: Way  # how they are explained
    traces: tuple[Trace, ...]  # the recordings; what is looked at is ``used``
    references: int  # number of references
    residual: Array  # measured minus explained angles of all in turn, rad, shape (n,)
    row: Array  # parameters of the servo, shape (P,)
    # derivatives of the angles by what the law shares among all, shape (n, F); F is 0 where no law
    # explains them
    shared: Array
    precision: Array  # precision of the prior of these parameters, shape (F, F)
    variance: float  # variance of a sample relative to that prior, with correlation counted, rad2
    scale2: float  # mean square residual of the references, at least that of rounding, rad2

    @cached_property
    def recording(self) -> Index:
        """Place of the recording of each sample, shape (n,)."""
        counts = [int(trace.used.sum()) for trace in self.traces]
        return np.repeat(np.arange(len(counts)), counts)

    @property
    def case(self) -> Mask:
        """Samples of the recordings in question, shape (n,)."""
        return np.asarray(self.recording >= self.references)

    def without(self, row: Array) -> Explained:
        """The recordings less what a change of the servo to ``row`` (P,) does in the case."""
        rows, residual = np.array([self.row, row]), self.residual.copy()
        before, after = simulated(self.traces[self.references :], rows, self.row)
        residual[self.case] -= after - before
        return replace(self, residual=residual)

    @property
    def energy(self) -> float:
        """Mean square residual of the case, rad2; 0 where nothing is looked at."""
        return _mean_square(self.residual[self.case])

    @property
    def loss(self) -> float:
        """Sum of squared residuals of all recordings, what they share at its best, rad2."""
        return float(self.residual @ self.settled.residual)

    @property
    def settled(self) -> Explained:
        """The same, less what the law explains better with what it shares at its best."""
        J = self.shared
        normal = self.variance * self.precision + J.T @ J
        law = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ (J.T @ self.residual)
        return replace(self, residual=self.residual - J @ law)


def simulated(traces: Sequence[Trace], rows: Array, servo: Array, *, substeps: int = 8) -> Array:
    """Angles of servos (B, P) at the used samples, with the sub-step of one of them, (B, n)."""
    simulator = Simulator(traces, threads=1)
    # A sensor's filter may be shorter than a sample, and no sub-step longer than that.
    longest = min(LONGEST_SUBSTEP_S, min(trace.period_s for trace in traces) / substeps)
    step = float(simulator.substeps(servo[None], longest_s=longest).min())
    angles = simulator.angles(rows, min(step, longest))
    return np.hstack([a[:, trace.used] for a, trace in zip(angles, traces, strict=True)])


def way_of(references: Sequence[Trace], case: Sequence[Trace]) -> Way:
    """How a case is best compared with its references."""
    steps = np.concatenate([np.diff(trace.t) for trace in (*references, *case)])
    if float(np.median(steps)) > DECISION.change.slow_sampling_s:
        return "rest"
    limit = DECISION.change.same_command
    repeats = (any(alignment(trace, other)[1] < limit for other in references) for trace in case)
    return "repeat" if all(repeats) else "law"


def explained(
    references: Sequence[Trace], case: Sequence[Trace], row: Array, servo: Servo
) -> Explained:
    """Explain recordings of a joint by its references, and by a servo of a row (P,)."""
    traces, R = (*references, *case), len(references)
    way, step = way_of(references, case), servo.position_step_rad
    smallest2, predicted = 1e-18, [True] * R
    if way == "rest":
        residuals, spread2 = beside_rest(traces, R, step)
        smallest2 = max(smallest2, spread2, step**2 / 12)
    else:
        residuals = _law_errors(traces, row)
    if way == "repeat":
        freed, repeated = freed_of_the_common(traces, [-np.nan_to_num(x) for x in residuals], R)
        triples = zip(residuals, freed, traces, strict=True)
        residuals = [error + (f.position - t.position) for error, f, t in triples]
        predicted = repeated[:R].tolist()
        if not any(predicted):
            noise = max(noise_floor(t.t, t.command, t.position) for t in references)
            smallest2 = max(smallest2, 4 * noise**2)
    looked = [replace(t, used=np.isfinite(x)) for t, x in zip(traces, residuals, strict=True)]
    parts = [x[trace.used] for x, trace in zip(residuals, looked, strict=True)]
    known = [x for x, is_known in zip(parts, predicted, strict=False) if is_known]
    scale2 = max(_mean_square(np.concatenate([*known, np.zeros(0)])), smallest2)
    residual, variance = np.concatenate(parts), scale2
    shared, precision = np.zeros((residual.size, 0)), np.zeros((0, 0))
    if way == "law":
        used = [name for name, x in zip(COLUMNS, row, strict=True) if name in GAINS or x > 0]
        law = ServoProblem(looked, row, motor_prior(servo, traces).of(used))
        x = law.searched(row[None])
        shared, (prior,) = law.slopes(x)[1][0], law.prior_slopes(x)[1]
        precision = prior.T @ prior
        variance *= float(np.mean([correlation_samples(x) for x in known]))
    return Explained(way, tuple(looked), R, residual, row, shared, precision, variance, scale2)


def _mean_square(values: Array) -> float:
    return float(np.mean(values**2)) if values.size else 0.0


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
    angles = np.split(simulated(full, row[None], row)[0], np.cumsum([t.t.size for t in traces]))
    for trace, angle in zip(traces, angles, strict=False):
        apart = np.diff(trace.t, prepend=trace.t[0])
        gap = apart > 1.5 * float(np.median(apart[1:]))
        last = np.maximum.accumulate(np.where(gap, np.arange(gap.size), 0))
        counts = trace.used & (trace.t - trace.t[last] > memory_s)
        errors.append(np.where(counts, trace.position - angle, np.nan))
    return errors


def misstated(of: Explained) -> tuple[tuple[str, ...], Array, float] | None:
    """Whether the case is explained better with the load of the references than with its own.

    Both loads are stated, and one servo is fitted to all recordings with the one or the other: with
    nothing free this tells more than the search for a load of any size.

    Returns:
        The effects that stand for the difference, the servo under the stated load with the
        difference, shape (P,), and the gain in log-likelihood with the references' load; None where
        the loads do not differ.
    """
    loads, row, effects = [trace.load for trace in of.traces], of.row.copy(), []
    known, stated, case = loads[0], loads[-1], of.traces[of.references :]
    if len({*loads[: of.references]}) > 1 or len({*loads[of.references :]}) > 1:
        return None
    for effect in CATALOGUE:
        if effect.load and (more := getattr(known, effect.load) - getattr(stated, effect.load)):
            row[COLUMNS.index(f"{effect.name}.{effect.parameters[0].name}")] += more
            effects.append(effect.name)
    if not effects:
        return None
    residual, one = of.residual.copy(), of.row[None]
    with_known = [replace(trace, load=known) for trace in case]
    residual[of.case] += (simulated(case, one, of.row) - simulated(with_known, one, of.row))[0]
    gain = 0.5 * (of.loss - replace(of, residual=residual).loss) / of.variance
    return tuple(effects), row, gain


def freed_of_the_common(
    traces: Sequence[Trace], residuals: Sequence[Array], references: int
) -> tuple[list[Trace], Mask]:
    """Traces corrected by the residuals of other references with the same command.

    Physics that a model lacks is in both recordings of one command, and not in their difference.
    ``residuals`` are simulated minus measured angles in rad, the references first.

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
    return differences, _mean_square(np.concatenate(spread))


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
