"""Search for the parameters of a servo: many starts at once, robust to outliers."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sim2real.arrays import Array, Index
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.inference.least_squares import Expansion, cannot_win, minimise, rms
from sim2real.inference.parameters import apart, column, kronecker
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    INERTIA_LEFT_OUT,
    LINE,
    LINE_COLUMNS,
    LOSSES,
    ROTOR,
)
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

FREQUENCY_RAD_S = (2.0, 300.0)
DAMPING_RATIO = (0.05, 4.0)
LATENCY_S = (0.0, 0.3)
"""Ranges of the natural frequency, damping ratio and latency of a first guess."""


def fit(
    problem: ServoProblem,
    starts: Array,
    *,
    rounds: int = 4,
    first: int = 40,
    later: int = 20,
    last: int = 60,
    effort: float = 1.0,
    behind: float = 30.0,
    rival: tuple[Fit, float] | None = None,
    rng: np.random.Generator | None = None,
) -> Fit:
    """Fit the free parameters of a servo from several starts (S, P).

    Levenberg-Marquardt searches run simultaneously; those that approach the minimum of a better one
    or fall ``behind`` it in log-likelihood end. The likelihood counts correlated residuals as fewer
    samples, so that misfit does not outweigh the prior; the scale of the residual is estimated
    again after each of at most ``rounds``, which end where it stays the same.

    ``first`` is the largest number of evaluations of a search in the first round, with long
    sub-steps, ``later`` that in later rounds, ``last`` that of the best search alone in the end;
    ``effort`` multiplies all three. ``rival`` is another fit, and by how much the first round must
    go below its loss: else the fit ends there, not at its minimum. ``rng`` draws the neighbours by
    which eight minima are ordered (``robust_order``), where a servo may stick or just not; by
    default losses order them.
    """
    x = problem.searched(starts)
    error = problem.residuals(x)
    noise = problem.noise(error[np.argmin(np.mean(np.abs(error), axis=1))])
    for number in range(rounds):
        evaluations = round(effort * (later if number else first))
        x, loss, _ = search(problem, x, noise, evaluations, rough=not number, behind=behind)
        error = problem.residuals(x[:1])
        scale, noise = noise[0], problem.noise(error[0])
        x = x[loss < loss[0] + behind] if number else x
        x = x[apart(x, 0.1)]
        if number and abs(noise[0] / scale - 1) < 0.05:
            break
        lower = rival[0].loss(*noise) - problem.loss(x[:1], error, *noise)[0] if rival else 0.0
        if rival is not None and not number and lower < rival[1]:
            x, last = x[:1], 0
            break
    if rng is not None and len(x) > 1:
        x = x[robust_order(problem, x[:8], noise, rng)]
    best, _, converged = search(problem, x[:1], noise, round(effort * last), settled=1e-6)
    x = np.concatenate([best, x[1:]])
    loss = problem.loss(x, problem.residuals(x), *noise)
    (error,), (slopes,) = problem.slopes(best, rough=False)
    return Fit(problem, x[0], error, slopes, *noise, converged, x[1:], loss[1:] - loss[0])


def search(
    problem: ServoProblem,
    x: Array,
    noise: tuple[float, float],
    evaluations: int,
    *,
    rough: bool = False,
    behind: float = 30.0,
    settled: float = 1e-3,
) -> tuple[Array, Array, bool]:
    """Search from points (S, F), for a scale of the residual in rad and its inflation (``noise``).

    As of ``fit``; residuals, too, have the longer sub-steps of derivatives if ``rough``. A search
    ends where it expects a decrease of half the loss below ``settled``. Returns the points in
    ascending order of their losses, the losses (S,), and whether the search for the best converged.
    """
    latest: dict[int, Array] = {}

    def losses(points: Array, index: Index) -> Array:
        error = problem.residuals(points, rough=rough)
        latest.update(zip(index.tolist(), error, strict=True))
        with np.errstate(over="ignore", invalid="ignore"):
            loss = 0.5 * problem.loss(points, error, *noise)
        return np.where(np.isfinite(loss), loss, np.inf)

    def expand(points: Array, index: Index) -> Expansion:
        if not set(index.tolist()) <= latest.keys():
            losses(points, index)
        error = np.array([latest[k] for k in index.tolist()])
        return problem.expansion(points, error, *noise, rough=rough)

    minimum = minimise(
        expand,
        x,
        *(np.tile(end, (len(x), 1)) for end in problem.box),
        evaluations=evaluations,
        settled=settled,
        hopeless=partial(cannot_win, behind=behind),
        losses=losses,
        look_every=1,
    )
    loss = minimum.expansion.loss
    order = np.argsort(loss)
    return minimum.x[order], 2 * loss[order], bool(minimum.converged[order[0]])


def robust_order(
    problem: ServoProblem, x: Array, noise: tuple[float, float], rng: np.random.Generator
) -> Index:
    """Indices of minima (M, F) by the mean loss of 128 neighbours, smallest first.

    Neighbours differ in rotor inertia and losses by a tenth of the prior's standard deviation.
    A narrow minimum owes its small loss to a coincidence, for instance of the moment at which
    the shaft sticks, and predicts other motions badly; so the expected loss of uncertain
    parameters is what counts (robust optimisation: Beyer and Sendhoff, Computer Methods in
    Applied Mechanics and Engineering 196 (2007) 3190-3218, sec. 2.2). ``noise`` as of
    ``search``.
    """
    varied = [k for k, name in enumerate(problem.names) if name in (ROTOR, *LOSSES)]
    sd = column(problem.parameters, "prior_sd")[varied] / problem.unit[varied]
    offset = 0.1 * sd * rng.standard_normal((128, len(varied)))
    low, high = problem.box
    means = np.empty(len(x))
    for k, minimum in enumerate(x):
        nearby = np.tile(minimum, (128, 1))
        nearby[:, varied] += offset
        nearby = np.clip(np.maximum(nearby, 2 * low - nearby), low, high)  # reflected at 0
        error = problem.residuals(nearby, rough=True)
        means[k] = problem.loss(nearby, error, *noise).mean()
    return np.argsort(means)


def errors_of(row: Array, traces: Sequence[Trace]) -> tuple[Array, ...]:
    """Simulated minus measured angles of a servo (P,) at the used samples of each trace, rad."""
    if not traces:
        return ()
    problem = ServoProblem([replace(trace, slow=None) for trace in traces], row, ())
    return problem.by_trace(problem.residuals(np.zeros((1, 0)))[0])


def error_on(row: Array, traces: Sequence[Trace]) -> float | None:
    """Root mean square of these errors in rad; None without traces."""
    return rms(errors_of(row, traces)) if traces else None


def first_guess(
    traces: Sequence[Trace],
    rng: np.random.Generator,
    *,
    rotor_kgm2: float = 0.0,
    fastest_rad_s: float = FREQUENCY_RAD_S[1],
) -> Array:
    """Servos that approximately fit the recordings, shape (S, P): the best, and different ones.

    Simulates a low-discrepancy set of servos over the segment with most motion in one batch, then,
    in a few narrower rounds, others around the best of them (the cross-entropy method: Rubinstein,
    Methodology and Computing in Applied Probability 1 (1999) 127-190).

    Candidates have ``rotor_kgm2`` in addition to the load's inertia and natural frequencies up to
    ``fastest_rad_s``. Where the recordings determine the gain there is one servo: four further ones
    at most have an error within 3 % of the smallest and gains that differ by 8 % of the range.
    """
    trace = _most_active(traces)
    inertia = trace.load.inertia_kgm2 + rotor_kgm2
    simulator = Simulator([trace])

    def errors(points: Array) -> Array:
        rows = _rows(points, inertia, rotor_kgm2)
        substeps = simulator.substeps(rows, 6.0, 4e-3)
        # the fast mode of strong damping decays within a millisecond
        (angle,) = simulator.angles(rows, np.maximum(substeps, 1e-3))
        return np.asarray(np.mean(np.abs(angle - trace.position)[:, trace.used], axis=1))

    points = kronecker(1024, 3, rng)
    low, high = np.log(FREQUENCY_RAD_S)
    points[:, 0] *= min(1.0, (np.log(fastest_rad_s) - low) / (high - low))
    error = errors(points)
    for spread in (0.1, 0.04, 0.015):
        best = np.argsort(error)[:16]
        points, error = points[best], error[best]
        around = np.repeat(points, 16, axis=0)
        drawn = np.clip(around + spread * rng.standard_normal(around.shape), 0.0, 1.0)
        error = np.append(error, errors(drawn))
        points = np.vstack([points, drawn])
    order = np.argsort(error)
    alike = points[order[error[order] < 1.03 * error[order[0]]]]
    chosen = apart(alike[:, :1], 0.08, 5)
    return _rows(alike[chosen], inertia, rotor_kgm2)


def drawn(
    problem: ServoProblem, base: Fit, rng: np.random.Generator, *, draws: int = 512, most: int = 12
) -> Array:
    """Servos (S, P) for a problem with more parameters than a fit, which start from that fit.

    What the fit does not have is drawn from its prior; parameters of effects are a multiple of
    their typical values, from 0.3 to 10, or absent in a quarter of the draws. As these take over a
    part of the gains, half of the draws have other gains. The first draw is kept, and those with
    the smallest errors in the segment with most motion, each half a natural unit from the others in
    a parameter.
    """
    rows = np.tile(problem.row, (draws, 1))
    known = [COLUMNS.index(name) for name in base.names if name in problem.names]
    rows[:, known] = base.row[known]
    for p in (p for p in problem.parameters if p.name not in base.names):
        if p.log or np.isfinite(p.prior_sd):
            width = p.prior_sd if np.isfinite(p.prior_sd) else 0.0
            value = p.nominal + width * rng.standard_normal(draws)
            value = np.exp(value) if p.log else 0.5 * np.abs(value)
        else:
            low, high = np.log([0.3, 10.0])
            share = rng.uniform(low, high, draws)
            value = np.where(rng.random(draws) < 0.25, 0.0, p.nominal * np.exp(share))
        rows[:, COLUMNS.index(p.name)] = np.clip(value, max(p.low, 0.0), p.high)
    half = draws // 2
    if ROTOR in problem.names and base.row[INERTIA_LEFT_OUT] > 0:  # of an arm's linear servo
        rows[:half, COLUMNS.index(ROTOR)] = base.row[INERTIA_LEFT_OUT]
    if BASE[0] in problem.names:
        others = rows[half:]
        if set(LINE) <= set(problem.names):  # damping by the back-EMF
            others[:, 1] = others[:, LINE_COLUMNS[0]] / others[:, LINE_COLUMNS[1]]
        others[:, 0] *= np.exp(rng.uniform(0.0, 1.2, len(others)))
        others[:, 1] *= np.exp(0.3 * rng.standard_normal(len(others)))
        others[:, 2] = rng.uniform(0.0, 1.05, len(others)) * np.maximum(others[:, 2], 0.01)
    windowed = replace(problem, traces=[_most_active(problem.traces)])
    x = windowed.searched(rows)
    size = np.mean(np.abs(windowed.residuals(x, rough=True)), axis=1)
    size[0] = 0.0
    order = np.argsort(size)
    return np.asarray(rows[order[apart(x[order] / problem.natural, 0.5, most)]])


def servos_at(points: Array, inertia: float | Array) -> Array:
    """Gains and latencies (kp, kd and latency in SI units) of servos at points of the unit cube.

    Points (N, 3) are frequency and damping ratio (logarithmic) and latency, as shares of the ranges
    of a first guess; the inertia of the load is in kg m2, a number or (..., 1). Shape (..., N, 3).
    """
    ranges = np.array([np.log(FREQUENCY_RAD_S), np.log(DAMPING_RATIO), LATENCY_S])
    values = ranges[:, 0] + points * np.diff(ranges, axis=1).T
    frequency, damping = np.exp(values[:, :2]).T
    kp = frequency**2 * inertia
    kd = 2 * damping * frequency * inertia
    return np.stack([kp, kd, np.broadcast_to(values[:, 2], kp.shape)], axis=-1)


def _rows(points: Array, inertia: float, rotor_kgm2: float) -> Array:
    """Servos at points (N, 3) of the unit cube, (N, P)."""
    rows = np.array([plain_row(*gains) for gains in servos_at(points, inertia)])
    rows[:, INERTIA_LEFT_OUT] = rotor_kgm2
    return rows


def _most_active(traces: Sequence[Trace]) -> Trace:
    """The segment of the recordings with most motion."""
    windows = [trace.window() for trace in traces]
    moving = [window for window in windows if window.moves() and window.used.any()]
    return max(moving or [trace for trace in traces if trace.used.any()], key=Trace.activity)
