"""The search for a starting point: an approximate servo from a scan of gains and latencies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.problem import plain_row
from sim2real.inference.parameters import kronecker
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

FREQUENCY_RAD_S = (2.0, 300.0)
DAMPING_RATIO = (0.05, 4.0)
LATENCY_S = (0.0, 0.3)
"""Ranges of the natural frequency, damping ratio and latency of a first guess."""


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
) -> tuple[Array, Array]:
    """Parameters of a servo that approximately fits the recordings, and of very different rivals.

    Simulates a low-discrepancy set of servos over the segment with most motion in one batch, then,
    in a few narrower rounds, others around the best of them (the cross-entropy method: Rubinstein,
    Methodology and Computing in Applied Probability 1 (1999) 127-190).

    Args:
        traces: The recorded joint, one trace per recording.
        rng: Generator for the candidates.
        rotor_kgm2: Inertia of the candidates in addition to that of the load.
        fastest_rad_s: Largest natural frequency of the candidates in rad/s.
        guesses: Number of servos in the first round.
        elite: Number of the best servos, about which further ones are drawn.
        spreads: Standard deviations of variations in each round, as shares of the ranges.
        rival_error: Largest error of a rival, relative to the smallest error.
        rival_distance: Smallest difference of a rival's gain, as a share of the range.
        most_rivals: Largest number of rivals.

    Returns:
        The best candidate, shape (P,), and rivals with nearly the same error but very different
        gains, shape (R, P): none if the recordings determine the gain.
    """
    windows = [trace.window() for trace in traces]
    moving = [window for window in windows if window.moves() and window.used.any()]
    trace = max(moving or [trace for trace in traces if trace.used.any()], key=Trace.activity)
    points = kronecker(guesses, 3, rng)
    low, high = np.log(FREQUENCY_RAD_S)
    points[:, 0] *= min(1.0, (np.log(fastest_rad_s) - low) / (high - low))
    error = _guess_errors(points, trace, rotor_kgm2)
    for spread in spreads:
        best = np.argsort(error)[:elite]
        points, error = points[best], error[best]
        around = np.repeat(points, guesses // (4 * elite), axis=0)
        drawn = np.clip(around + spread * rng.standard_normal(around.shape), 0.0, 1.0)
        error = np.append(error, _guess_errors(drawn, trace, rotor_kgm2))
        points = np.vstack([points, drawn])
    order = np.argsort(error)
    equal = order[error[order] < rival_error * error[order[0]]]
    chosen = [equal[0]]
    for candidate in equal[1:]:
        distance = np.abs(points[chosen, 0] - points[candidate, 0]).min()
        if distance > rival_distance and len(chosen) <= most_rivals:
            chosen.append(candidate)
    inertia = trace.load.inertia_kgm2 + rotor_kgm2
    rows = np.array([plain_row(*x) for x in servos_at(points[chosen], inertia)])
    rows[:, INERTIA_LEFT_OUT] = rotor_kgm2
    return rows[0], rows[1:]


def _guess_errors(points: Array, trace: Trace, rotor_kgm2: float) -> Array:
    """Mean absolute error in rad of the servos at ``points`` (N, 3), shape (N,)."""
    rows = np.zeros((points.shape[0], len(COLUMNS)))
    rows[:, :3] = servos_at(points, trace.load.inertia_kgm2 + rotor_kgm2)
    rows[:, INERTIA_LEFT_OUT] = rotor_kgm2
    simulator = Simulator([trace])
    substeps = simulator.substeps(rows, 6.0, 4e-3, exact=simulator.is_linear(rows))
    # the fast mode of strong damping decays within a millisecond
    (angle,) = simulator.angles(rows, np.maximum(substeps, 1e-3))
    return np.asarray(np.mean(np.abs(angle - trace.position)[:, trace.used], axis=1))


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
