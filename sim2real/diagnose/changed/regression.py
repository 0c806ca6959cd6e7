"""Regression of a recording on what could have changed since its references.

The prediction of an unchanged recording is, in this order, the mean residual of references with the
same command (``repeat``), where the references came to rest if the servo is sampled slowly
(``rest``, see ``slow_sampling``), or the servo's law with the references' parameters (``law``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.changed.repeated_commands import alignment, freed_of_the_common
from sim2real.diagnose.changed.slow_sampling import beside_rest, is_slow
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.screening import candidate, candidates
from sim2real.effects import named
from sim2real.identification.fit import STEPS_PER_RADIAN
from sim2real.identification.motor_prior import motor_prior
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import Expansion, expansion, minimise, stacked
from sim2real.noise import noise_floor
from sim2real.robot import Servo
from sim2real.servo.parameters import BASE, COLUMNS, INERTIA_LEFT_OUT, ROTOR_INERTIA
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, Simulator
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]
Way = Literal["repeat", "rest", "law"]
Names = tuple[str, ...]

_DIFFERENCE = 1e-3
_GAINS = BASE[:3]


@dataclass(frozen=True)
class Explained:
    """Recordings of a joint, the references first, and what is left of them.

    Attributes:
        way: How they are explained.
        traces: The recordings.
        references: How many of them are references.
        left: Measured minus explained angles in rad, NaN where not looked at, (T,) each.
        row: Parameters of the servo, shape (P,).
        shared: Derivatives of the angles by what the law shares among all, (T, F) each; F is 0
            where no law explains them.
        precision: Precision of the prior of these parameters, shape (F, F).
        variance: Variance of a sample relative to that prior, with correlation counted, rad2.
        scale2: Mean square of what is left of the references, at least that of rounding, rad2.
    """

    way: Way
    traces: tuple[Trace, ...]
    references: int
    left: tuple[Array, ...]
    row: Array
    shared: tuple[Array, ...]
    precision: Array
    variance: float
    scale2: float

    @property
    def case(self) -> list[int]:
        """Places of the recordings in question."""
        return list(range(self.references, len(self.traces)))

    def seen(self, r: int) -> NDArray[np.bool_]:
        """Samples of a recording that are looked at, shape (T,)."""
        return np.isfinite(self.left[r])

    def simulated(self, rows: Array, places: Sequence[int]) -> list[Array]:
        """Angles of servos (B, P) in some of the recordings, (B, T) each."""
        return simulated([self.traces[r] for r in places], rows, self.row)


def simulated(
    traces: Sequence[Trace], rows: Array, servo: Array, *, substeps: int = 8
) -> list[Array]:
    """Angles of servos (B, P) with the sub-step of one of them, (B, T) for each trace."""
    simulator = Simulator(traces, threads=1)
    # A sensor's filter may be shorter than a sample, and no sub-step longer than that.
    period = min(float(np.median(np.diff(trace.t))) for trace in traces)
    longest = min(LONGEST_SUBSTEP_S, period / substeps)
    step = simulator.substep(servo[None], STEPS_PER_RADIAN, longest)
    return simulator.angles(rows, min(step, longest))


def way_of(references: Sequence[Trace], case: Sequence[Trace]) -> Way:
    """How a case is best compared with its references."""
    every = [*references, *case]
    if is_slow(every):
        return "rest"
    limit = DECISION.change.same_command
    again = all(any(alignment(one, other)[1] < limit for other in references) for one in case)
    return "repeat" if again else "law"


def explained(
    references: Sequence[Trace], case: Sequence[Trace], row: Array, servo: Servo
) -> Explained:
    """Explain all recordings of a joint by its servo, as the references tell it.

    Args:
        references: The joint's references.
        case: The joint's recordings in question.
        row: Parameters of the servo, shape (P,).
        servo: Its data sheet.
    """
    every, R = [*references, *case], len(references)
    way, step = way_of(references, case), servo.position_step_rad
    shared, precision = tuple(np.zeros((trace.t.size, 0)) for trace in every), np.zeros((0, 0))
    spread2, telling = 0.0, [True] * R
    if way == "rest":
        left, spread2 = beside_rest(every, R, step)
    else:
        pairs = zip(every, simulated(every, row[None], row), strict=True)
        settles_s = _settles_s(row, every[0].load.inertia_kgm2)
        left = [_masked(t, t.position - angle[0], settles_s) for t, angle in pairs]
    if way == "repeat":
        freed, repeated = freed_of_the_common(every, [-np.nan_to_num(x) for x in left], R)
        triples = zip(left, freed, every, strict=True)
        left = [part + (f.position - t.position) for part, f, t in triples]
        telling = repeated[:R].tolist()
        if not any(telling):
            spread2 = 4 * max(noise_floor(t.t, t.command, t.position) for t in references) ** 2
    if way == "law":
        shared, precision = _derivatives(every, row, servo)
    parts = [x[np.isfinite(x)] for x, tells in zip(left, telling, strict=False) if tells]
    known = np.concatenate([*parts, np.zeros(0)])
    scale2 = float(np.mean(known**2)) if known.size else 0.0
    scale2 = max(scale2, spread2, step**2 / 12 if way == "rest" else 0.0, 1e-18)
    correlated = float(np.mean([correlation_samples(x) for x in parts])) if parts else 1.0
    variance = scale2 * (correlated if way == "law" else 1.0)
    return Explained(way, tuple(every), R, tuple(left), row, shared, precision, variance, scale2)


def _settles_s(row: Array, inertia: float, *, limits_s: tuple[float, float] = (0.05, 0.4)) -> float:
    """Time in which a servo forgets all but e^-12 of what was sent: six of a million."""
    total = inertia + float(row[ROTOR_INERTIA]) + float(row[INERTIA_LEFT_OUT])
    kp, kd, latency = (float(x) for x in row[:3])
    rate = np.real((kd - np.sqrt(complex(kd**2 - 4 * kp * total))) / (2 * total))
    return float(np.clip(latency + 12 / max(rate, 1e-9), *limits_s))


def _masked(trace: Trace, values: Array, settles_s: float) -> Array:
    """The values where they count: not soon after the beginning or a gap.

    Nobody knows what was sent before the one and in the other.
    """
    apart = np.diff(trace.t, prepend=trace.t[0])
    gap = apart > 1.5 * float(np.median(apart[1:]))
    last = np.maximum.accumulate(np.where(gap, np.arange(gap.size), 0))
    return np.where(trace.used & (trace.t - trace.t[last] > settles_s), values, np.nan)


def _derivatives(
    traces: Sequence[Trace], row: Array, servo: Servo
) -> tuple[tuple[Array, ...], Array]:
    """Derivatives of angles by the gains and the motor's parameters, in spreads or units."""
    prior = motor_prior(servo, traces)
    parameters = [b for b in prior.parameters if b.name in _GAINS or row[COLUMNS.index(b.name)] > 0]
    size = np.array([p.typical for p in parameters])
    rows = np.tile(row, (1 + len(parameters), 1))
    for k, parameter in enumerate(parameters):
        column, step = COLUMNS.index(parameter.name), _DIFFERENCE * parameter.typical
        now = rows[1 + k, column]
        rows[1 + k, column] = now * np.exp(step) if parameter.log else now + step
    slopes = [(a[1:] - a[:1]).T / _DIFFERENCE for a in simulated(traces, rows, row)]
    sd = np.array([p.prior_sd for p in parameters])
    return tuple(slopes), np.diag((size / sd) ** 2)


@dataclass(frozen=True)
class Directions:
    """Every start of every effect, and of the plain servo's parameters.

    Attributes:
        names: Effect or parameter of each, of which there are K.
        rows: The servo with it, shape (K, P).
        signed: Whether it means something backwards, too, shape (K,).
        moved: How it moves the angles of each recording, (K, T) each.
    """

    names: Names
    rows: Array
    signed: NDArray[np.bool_]
    moved: tuple[Array, ...]


def directions(of: Explained) -> Directions:
    """Simulate them all."""
    kp, inertia = float(of.row[0]), of.traces[0].load.inertia_kgm2
    present = {COLUMNS[k].partition(".")[0] for k in np.flatnonzero(of.row) if "." in COLUMNS[k]}
    options = candidates(frozenset(present - {"motor"}), kp, inertia)
    options = [c for c in options if not c.effect.everywhere]
    rows, names = [], []
    if of.way != "rest":
        for k, name in enumerate(_GAINS):
            rows.append(of.row.copy())
            rows[-1][k] += 0.01 if name == "latency_s" else 0.1 * of.row[k]
            names.append(name)
    for option in options:
        for start in option.starts:
            rows.append(of.row.copy())
            rows[-1][option.columns] = start
            names.append(option.effect.name)
    table = np.array([of.row, *rows])
    angles = of.simulated(table, range(len(of.traces)))
    moved = tuple(np.nan_to_num(a[1:] - a[:1]) for a in angles)
    signed = np.array([n in _GAINS or named(n).either_sign for n in names])
    return Directions(tuple(names), table[1:], signed, moved)


def first_look(of: Explained, by: Directions, own: Sequence[int]) -> tuple[Array, Array, Array]:
    """Free each direction in some recordings only, what the law shares in all.

    Least squares, linear in all parameters, one variance for all recordings. Where it is free in
    references, the case is left out: what changed there is nothing that references leave.

    Args:
        of: The recordings.
        by: The directions.
        own: Those in which it is free.

    Returns:
        What it takes away from them, as a mean square in rad2, its size in multiples of the start,
        and the mean square that is left of them, each of shape (K,).
    """
    K, F = len(by.names), of.precision.shape[0]
    normal, slope = of.variance * of.precision, np.zeros(F)
    cross, along, square = np.zeros((F, K)), np.zeros(K), np.zeros(K)
    for r in {*range(of.references), *own}:
        seen = of.seen(r)
        J, e = of.shared[r][seen], of.left[r][seen]
        normal = normal + J.T @ J
        slope = slope + J.T @ e
        if r in own:
            D = by.moved[r][:, seen]
            cross += J.T @ D.T
            along += D @ e
            square += (D**2).sum(axis=1)
    count = sum(int(np.count_nonzero(of.seen(r))) for r in own)
    if not count:
        return np.zeros(K), np.zeros(K), np.zeros(K)
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) if F else normal
    along = along - cross.T @ (inverse @ slope)
    free = square - np.einsum("fk,fg,gk->k", cross, inverse, cross)
    told = free > 1e-6 * square + 1e-30
    size = np.where(told, along / np.where(told, free, 1.0), 0.0)
    size[(size < 0) & ~by.signed] = 0.0
    law = inverse @ (slope[:, None] - cross * size)
    left = np.zeros(K)
    for r in own:
        seen = of.seen(r)
        rest = of.left[r][seen][:, None] - of.shared[r][seen] @ law
        left += ((rest - by.moved[r][:, seen].T * size) ** 2).sum(axis=0)
    return np.where(told, size * along, 0.0) / count, size, left / count


def first_pairs(of: Explained, by: Directions) -> dict[frozenset[str], tuple[Array, float]]:
    """Each pair of effects as the case is explained best, to first order, the best pair first.

    By least squares; no law shares anything.

    Returns:
        For each pair the servo with it, shape (P,), and what it leaves, rad2; infinite where one
        lies farther than its start, as no straight line leads there.
    """
    seen = np.concatenate([of.seen(r) for r in of.case])
    e = np.concatenate([of.left[r] for r in of.case])[seen]
    D = np.concatenate([by.moved[r] for r in of.case], axis=1)[:, seen]
    gram, along = D @ D.T, D @ e
    square = np.diag(gram)
    free = square[:, None] * square - gram**2
    told = free > 1e-6 * square[:, None] * square
    size = along[:, None] * square - along * gram  # of the first of two, times ``free``
    size = np.divide(size, free, out=np.zeros_like(size), where=told)
    gone = size * along[:, None]
    gone = gone + gone.T
    wrong = (size < 0) & ~by.signed[:, None]
    plain = np.isin(by.names, _GAINS)
    gone[wrong | wrong.T | ~told | plain[:, None] | plain] = 0.0
    far = np.abs(size) > 1
    left = np.where(far | far.T, np.inf, np.maximum(e @ e - gone, 0.0) / max(e.size, 1))
    found: dict[frozenset[str], tuple[Array, float]] = {}
    for i, j in zip(*np.unravel_index(np.argsort(-gone, axis=None), gone.shape), strict=True):
        pair = frozenset((by.names[i], by.names[j]))
        if gone[i, j] > 0 and len(pair) == 2 and pair not in found:
            more = size[i, j] * (by.rows[i] - of.row) + size[j, i] * (by.rows[j] - of.row)
            found[pair] = of.row + more, float(left[i, j])
    return found


def energy(of: Explained, places: Sequence[int]) -> float:
    """Mean square of what is left of some recordings, rad2; 0 where nothing is looked at."""
    every = np.concatenate([of.left[r][of.seen(r)] for r in places])
    return float(np.mean(every**2)) if every.size else 0.0


def _refit(of: Explained) -> tuple[Array, float]:
    """What the law shares as it explains all recordings best, (F,), and what is left, rad2."""
    normal, slope, total = of.variance * of.precision, np.zeros(of.precision.shape[0]), 0.0
    for r, left in enumerate(of.left):
        seen = of.seen(r)
        J, e = of.shared[r][seen], left[seen]
        normal, slope, total = normal + J.T @ J, slope + J.T @ e, total + float(e @ e)
    law = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ slope
    return law, total - float(slope @ law)


def loss(of: Explained) -> float:
    """Sum of squares that is left of all recordings, what they share at its best, rad2."""
    return _refit(of)[1]


def settled(of: Explained) -> Explained:
    """The same, less what the law explains better with what it shares at its best."""
    law, _ = _refit(of)
    pairs = zip(of.left, of.shared, strict=True)
    return replace(of, left=tuple(left - slopes @ law for left, slopes in pairs))


def fitted(
    of: Explained, effects: Sequence[str], starts: Sequence[Array], *, evaluations: int = 40
) -> tuple[Array, float]:
    """The servo (P,) with these effects as they explain the case best, and what they leave, rad2.

    The servo itself stays; an effect may be a parameter of the plain servo.

    Args:
        of: The recordings.
        effects: Names of the effects.
        starts: Servos to start from, shape (P,) each.
        evaluations: Evaluations of each fit at most.
    """
    kp, inertia = float(of.row[0]), of.traces[0].load.inertia_kgm2
    columns: list[int] = []
    low: list[float] = []
    high: list[float] = []
    unit: list[float] = []
    for name in effects:
        if name in _GAINS:
            columns += [_GAINS.index(name)]
            value = max(float(of.row[columns[-1]]), 1e-6)
            low, high = [*low, 0.0], [*high, 0.5 if name == "latency_s" else 30 * value]
            unit += [0.02 if name == "latency_s" else value]
        else:
            option = candidate(named(name), kp, inertia)
            columns += option.columns.tolist()
            low, high = [*low, *option.low], [*high, *option.high]
            unit += option.unit.tolist()
    scale, box = np.array(unit), (np.array(low) / unit, np.array(high) / unit)
    base = of.simulated(of.row[None], of.case)

    def left(x: Array) -> Array:
        rows = np.tile(of.row, (len(x), 1))
        rows[:, columns] = x * scale
        moved = [a - b for a, b in zip(of.simulated(rows, of.case), base, strict=True)]
        parts = [(of.left[r] - m)[:, of.seen(r)] for r, m in zip(of.case, moved, strict=True)]
        return np.nan_to_num(np.concatenate(parts, axis=1), nan=1e3)

    noise = np.sqrt(of.scale2)

    def about(x: Array) -> Expansion:
        step = np.where(x + _DIFFERENCE > box[1], -_DIFFERENCE, _DIFFERENCE)
        error, *beside = left(np.vstack([x, x + np.diag(step)])) / noise
        return expansion(error, ((np.array(beside) - error) / step[:, None]).T)

    x0 = np.array([start[columns] / scale for start in starts])
    found = minimise(
        lambda points, _: stacked([about(x) for x in points]),
        x0,
        *(np.tile(ends, (len(starts), 1)) for ends in box),
        evaluations=evaluations,
        settled=1e-3,
    )
    k = int(np.argmin(found.expansion.loss))
    best = of.row.copy()
    best[columns] = found.x[k] * scale
    count = max(sum(int(np.count_nonzero(of.seen(r))) for r in of.case), 1)
    return best, 2 * float(found.expansion.loss[k]) * of.scale2 / count


def restated(of: Explained, load_of: Trace) -> Explained:
    """The same with the case's load stated as that of another recording."""
    case = [replace(of.traces[r], load=load_of.load) for r in of.case]
    traces = (*of.traces[: of.references], *case)
    angles = simulated(case, of.row[None], of.row)
    settles_s = _settles_s(of.row, load_of.load.inertia_kgm2)
    left = [_masked(t, t.position - a[0], settles_s) for t, a in zip(case, angles, strict=True)]
    return replace(of, traces=traces, left=(*of.left[: of.references], *left))
