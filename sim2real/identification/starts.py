"""Starts of fits: a scan of gains and latencies, and draws of what a simpler fit does not have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.inference.parameters import apart, kronecker
from sim2real.servo.parameters import BASE, COLUMNS, INERTIA_LEFT_OUT, LINE, ROTOR
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

FREQUENCY_RAD_S = (2.0, 300.0)
DAMPING_RATIO = (0.05, 4.0)
LATENCY_S = (0.0, 0.3)
"""Ranges of the natural frequency, damping ratio and latency of a first guess."""
_LINE = [COLUMNS.index(name) for name in LINE]


def first_guess(
    traces: Sequence[Trace],
    rng: np.random.Generator,
    *,
    rotor_kgm2: float = 0.0,
    fastest_rad_s: float = FREQUENCY_RAD_S[1],
    guesses: int = 1024,
    elite: int = 16,
    spreads: Sequence[float] = (0.1, 0.04, 0.015),
    rival_error: float = 1.03,
    rival_distance: float = 0.08,
    most_rivals: int = 4,
) -> Array:
    """Servos that approximately fit the recordings, shape (S, P): the best, and different ones.

    Simulates a low-discrepancy set of servos over the segment with most motion in one batch, then,
    in a few narrower rounds, others around the best of them (the cross-entropy method: Rubinstein,
    Methodology and Computing in Applied Probability 1 (1999) 127-190).

    Candidates have ``rotor_kgm2`` in addition to the load's inertia and natural frequencies up to
    ``fastest_rad_s``. Where the recordings determine the gain there is one servo: further ones
    have an error within a factor ``rival_error`` of the smallest and gains that differ by
    ``rival_distance`` of the range.
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

    points = kronecker(guesses, 3, rng)
    low, high = np.log(FREQUENCY_RAD_S)
    points[:, 0] *= min(1.0, (np.log(fastest_rad_s) - low) / (high - low))
    error = errors(points)
    for spread in spreads:
        best = np.argsort(error)[:elite]
        points, error = points[best], error[best]
        around = np.repeat(points, guesses // (4 * elite), axis=0)
        drawn = np.clip(around + spread * rng.standard_normal(around.shape), 0.0, 1.0)
        error = np.append(error, errors(drawn))
        points = np.vstack([points, drawn])
    order = np.argsort(error)
    alike = points[order[error[order] < rival_error * error[order[0]]]]
    chosen = apart(alike[:, :1], rival_distance, 1 + most_rivals)
    return _rows(alike[chosen], inertia, rotor_kgm2)


def drawn(
    problem: ServoProblem,
    base: Fit,
    rng: np.random.Generator,
    *,
    draws: int = 512,
    most: int = 12,
    strengths: tuple[float, float] = (0.3, 10.0),
    absent: float = 0.25,
    distance: float = 0.5,
) -> Array:
    """Servos (S, P) for a problem with more parameters than a fit, which start from that fit.

    What the fit does not have is drawn from its prior; parameters of effects are a multiple of
    their typical values, within ``strengths``, or ``absent`` in a share of the draws. As these
    take over a part of the gains, half of the draws have other gains. The first draw is kept, and
    those with the smallest errors in the segment with most motion, each at a ``distance`` from the
    others in a parameter, in natural units.
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
            low, high = np.log(strengths)
            share = rng.uniform(low, high, draws)
            value = np.where(rng.random(draws) < absent, 0.0, p.nominal * np.exp(share))
        rows[:, COLUMNS.index(p.name)] = np.clip(value, max(p.low, 0.0), p.high)
    half = draws // 2
    if ROTOR in problem.names and base.row[INERTIA_LEFT_OUT] > 0:  # of an arm's linear servo
        rows[:half, COLUMNS.index(ROTOR)] = base.row[INERTIA_LEFT_OUT]
    if BASE[0] in problem.names:
        others = rows[half:]
        if set(LINE) <= set(problem.names):  # damping by the back-EMF
            others[:, 1] = others[:, _LINE[0]] / others[:, _LINE[1]]
        others[:, 0] *= np.exp(rng.uniform(0.0, 1.2, len(others)))
        others[:, 1] *= np.exp(0.3 * rng.standard_normal(len(others)))
        others[:, 2] = rng.uniform(0.0, 1.05, len(others)) * np.maximum(others[:, 2], 0.01)
    windowed = replace(problem, traces=[_most_active(problem.traces)])
    x = windowed.searched(rows)
    size = np.mean(np.abs(windowed.residuals(x, rough=True)), axis=1)
    size[0] = 0.0
    order = np.argsort(size)
    return np.asarray(rows[order[apart(x[order] / problem.natural, distance, most)]])


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
