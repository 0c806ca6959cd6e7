"""Recordings as their references explain them.

The prediction of an unchanged recording is, in this order, the mean residual of references with the
same command (``repeat``), where the references came to rest if the servo is sampled slowly
(``rest``), or the servo's law with the references' parameters (``law``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.changed.comparison import alignment, beside_rest, freed_of_the_common
from sim2real.diagnose.decision import DECISION
from sim2real.effects import CATALOGUE
from sim2real.identification.priors import motor_prior
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.noise import noise_floor
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, COLUMNS, beyond_load
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, Simulator
from sim2real.servo.trace import Trace

Way = Literal["repeat", "rest", "law"]

DIFFERENCE = 1e-3
"""Step of the forward differences, in units of the parameter."""
GAINS = BASE[:3]


@dataclass(frozen=True)
class Explained:
    """Recordings of a joint, the references first, and their residuals.

    Attributes:
        way: How they are explained.
        traces: The recordings.
        references: Number of references.
        residuals: Measured minus explained angles in rad, NaN where not looked at, (T,) each.
        row: Parameters of the servo, shape (P,).
        shared: Derivatives of the angles by what the law shares among all, (T, F) each; F is 0
            where no law explains them.
        precision: Precision of the prior of these parameters, shape (F, F).
        variance: Variance of a sample relative to that prior, with correlation counted, rad2.
        scale2: Mean square residual of the references, at least that of rounding, rad2.
    """

    way: Way
    traces: tuple[Trace, ...]
    references: int
    residuals: tuple[Array, ...]
    row: Array
    shared: tuple[Array, ...]
    precision: Array
    variance: float
    scale2: float

    @property
    def case(self) -> list[int]:
        """Places of the recordings in question."""
        return list(range(self.references, len(self.traces)))

    def seen(self, r: int) -> Mask:
        """Samples of a recording that are looked at, shape (T,)."""
        return np.isfinite(self.residuals[r])

    def count(self, places: Sequence[int]) -> int:
        """Number of samples of some recordings that are looked at."""
        return sum(int(np.count_nonzero(self.seen(r))) for r in places)

    def simulated(self, rows: Array, places: Sequence[int]) -> list[Array]:
        """Angles of servos (B, P) in some of the recordings, (B, T) each."""
        return simulated([self.traces[r] for r in places], rows, self.row)


def simulated(
    traces: Sequence[Trace], rows: Array, servo: Array, *, substeps: int = 8
) -> list[Array]:
    """Angles of servos (B, P) with the sub-step of one of them, (B, T) for each trace."""
    simulator = Simulator(traces, threads=1)
    # A sensor's filter may be shorter than a sample, and no sub-step longer than that.
    period = min(trace.period_s for trace in traces)
    longest = min(LONGEST_SUBSTEP_S, period / substeps)
    step = float(simulator.substeps(servo[None], longest_s=longest).min())
    return simulator.angles(rows, min(step, longest))


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
    """Explain all recordings of a joint by its references.

    Args:
        references: The joint's references.
        case: The joint's recordings in question.
        row: Parameters of the servo, shape (P,).
        servo: Its data sheet.
    """
    traces, R = (*references, *case), len(references)
    way, step = way_of(references, case), servo.position_step_rad
    shared, precision = tuple(np.zeros((trace.t.size, 0)) for trace in traces), np.zeros((0, 0))
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
    if way == "law":
        shared, precision = _derivatives(traces, row, servo)
    known = [
        x[np.isfinite(x)] for x, is_known in zip(residuals, predicted, strict=False) if is_known
    ]
    values = np.concatenate([*known, np.zeros(0)])
    scale2 = max(float(np.mean(values**2)) if values.size else 0.0, smallest2)
    correlated = [correlation_samples(x) for x in known] if way == "law" else []
    variance = scale2 * (float(np.mean(correlated)) if correlated else 1.0)
    return Explained(way, traces, R, tuple(residuals), row, shared, precision, variance, scale2)


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
    for trace, angle in zip(traces, simulated(traces, row[None], row), strict=True):
        apart = np.diff(trace.t, prepend=trace.t[0])
        gap = apart > 1.5 * float(np.median(apart[1:]))
        last = np.maximum.accumulate(np.where(gap, np.arange(gap.size), 0))
        counts = trace.used & (trace.t - trace.t[last] > memory_s)
        errors.append(np.where(counts, trace.position - angle[0], np.nan))
    return errors


def _derivatives(
    traces: Sequence[Trace], row: Array, servo: Servo
) -> tuple[tuple[Array, ...], Array]:
    """Derivatives of angles by the gains and the motor's parameters, in units; their precision."""
    prior = motor_prior(servo, traces)
    parameters = [p for p in prior.parameters if p.name in GAINS or row[COLUMNS.index(p.name)] > 0]
    rows = np.tile(row, (1 + len(parameters), 1))
    for k, p in enumerate(parameters):
        column, step = COLUMNS.index(p.name), DIFFERENCE * p.typical
        now = rows[1 + k, column]
        rows[1 + k, column] = now * np.exp(step) if p.log else now + step
    slopes = [(a[1:] - a[:1]).T / DIFFERENCE for a in simulated(traces, rows, row)]
    relative = np.array([p.typical for p in parameters]) / np.array(
        [p.prior_sd for p in parameters]
    )
    return tuple(slopes), np.diag(relative**2)


def energy(of: Explained) -> float:
    """Mean square residual of the case, rad2; 0 where nothing is looked at."""
    values = np.concatenate([of.residuals[r][of.seen(r)] for r in of.case])
    return float(np.mean(values**2)) if values.size else 0.0


def loss(of: Explained) -> float:
    """Sum of squared residuals of all recordings, what they share at its best, rad2."""
    return _refit(of)[1]


def settled(of: Explained) -> Explained:
    """The same, less what the law explains better with what it shares at its best."""
    law, _ = _refit(of)
    pairs = zip(of.residuals, of.shared, strict=True)
    return replace(of, residuals=tuple(residual - slopes @ law for residual, slopes in pairs))


def _refit(of: Explained) -> tuple[Array, float]:
    """Shared parameters that explain all recordings best, (F,), and the sum of squares, rad2."""
    normal, slope, total = of.variance * of.precision, np.zeros(of.precision.shape[0]), 0.0
    for r, residual in enumerate(of.residuals):
        seen = of.seen(r)
        J, e = of.shared[r][seen], residual[seen]
        normal, slope, total = normal + J.T @ J, slope + J.T @ e, total + float(e @ e)
    law = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ slope
    return law, total - float(slope @ law)


def misstated(of: Explained) -> tuple[tuple[str, ...], Array, float] | None:
    """Whether the case is explained better with the load of the references than with its own.

    Both loads are stated, and one servo is fitted to all recordings with the one or the other: with
    nothing free this tells more than the search for a load of any size.

    Returns:
        The effects that stand for the difference, the servo under the stated load with the
        difference, shape (P,), and the gain in log-likelihood with the references' load; None where
        the loads do not differ.
    """
    known, stated = of.traces[0].load, of.traces[of.references].load
    references, case = of.traces[: of.references], of.traces[of.references :]
    if any(t.load != known for t in references) or any(t.load != stated for t in case):
        return None
    row, effects = of.row.copy(), []
    for effect in CATALOGUE:
        if effect.load and (more := getattr(known, effect.load) - getattr(stated, effect.load)):
            row[COLUMNS.index(f"{effect.name}.{effect.parameters[0].name}")] += more
            effects.append(effect.name)
    if not effects:
        return None
    case = tuple(replace(trace, load=known) for trace in case)
    residuals = (*of.residuals[: of.references], *_law_errors(case, of.row))
    with_known = replace(of, traces=(*references, *case), residuals=residuals)
    return tuple(effects), row, 0.5 * (loss(of) - loss(with_known)) / of.variance
