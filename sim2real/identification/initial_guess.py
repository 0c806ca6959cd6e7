"""Starting point of a fit: a search over frequency, damping and latency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.identification.fit import plain_row
from sim2real.inference.low_discrepancy import kronecker
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.rollout import Simulator, longest_substep, rollout
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

WINDOW_S = 8.0
FREQUENCY_RAD_S = (2.0, 300.0)
DAMPING_RATIO = (0.05, 4.0)
LATENCY_S = (0.0, 0.3)


@dataclass(frozen=True)
class GuessSearch:
    """Settings of the search for a starting point.

    Attributes:
        candidates: Number of servos in the first round.
        elite: Number of the best ones, about which further ones are drawn.
        spreads: Standard deviation of the candidates about the best ones in each round, as a share
            of the ranges.
        rival_error: Largest error of a rival, relative to the smallest error.
        rival_distance: Smallest difference of its gain, as a share of the range.
        most_rivals: Largest number of rivals.
        steps_per_radian: Sub-steps per radian of the fastest mode of a candidate.
        substep_s: Shortest and longest sub-step; faster modes of strongly damped candidates decay
            within the shortest one.
    """

    candidates: int = 1024
    elite: int = 16
    spreads: tuple[float, float, float] = (0.1, 0.04, 0.015)
    rival_error: float = 1.03
    rival_distance: float = 0.08
    most_rivals: int = 4
    steps_per_radian: float = 6.0
    substep_s: tuple[float, float] = (1e-3, 4e-3)


GUESS_SEARCH = GuessSearch()
"""The defaults."""


def first_guess(
    traces: Sequence[Trace], rng: np.random.Generator, *, search: GuessSearch = GUESS_SEARCH
) -> tuple[Array, Array]:
    """Parameters of a servo that approximately fits the recordings, and of very different rivals.

    Simulates a low-discrepancy set of servos over the segment with most motion in one batch, then,
    in a few narrower rounds, others around the best of them (the cross-entropy method: Rubinstein,
    Methodology and Computing in Applied Probability 1 (1999) 127-190).

    Args:
        traces: The recorded joint, one trace per recording.
        rng: Generator for the candidates.
        search: Settings of the search.

    Returns:
        The best candidate, shape (P,), and rivals with nearly the same error but very different
        gains, shape (R, P): none if the recordings determine the gain.
    """
    windows = [trace.window(WINDOW_S) for trace in traces]
    moving = [window for window in windows if window.moves() and window.used.any()]
    trace = max(moving or [trace for trace in traces if trace.used.any()], key=Trace.activity)
    points = kronecker(search.candidates, 3, rng)
    error = _errors(points, trace, search=search)
    for spread in search.spreads:
        best = np.argsort(error)[: search.elite]
        points, error = points[best], error[best]
        around = np.repeat(points, search.candidates // (4 * search.elite), axis=0)
        drawn = np.clip(around + spread * rng.standard_normal(around.shape), 0.0, 1.0)
        points, error = (
            np.vstack([points, drawn]),
            np.append(error, _errors(drawn, trace, search=search)),
        )
    order = np.argsort(error)
    equal = order[error[order] < search.rival_error * error[order[0]]]
    chosen = [equal[0]]
    for candidate in equal[1:]:
        distance = np.abs(points[chosen, 0] - points[candidate, 0]).min()
        if distance > search.rival_distance and len(chosen) <= search.most_rivals:
            chosen.append(candidate)
    rows = np.array([plain_row(*x) for x in servos_at(points[chosen], trace.load.inertia_kgm2)])
    return rows[0], rows[1:]


def _errors(points: Array, trace: Trace, *, search: GuessSearch) -> Array:
    """Mean absolute error in rad of the servos at ``points`` (N, 3), shape (N,)."""
    theta = np.zeros((points.shape[0], len(COLUMNS)))
    theta[:, :3] = servos_at(points, trace.load.inertia_kgm2)
    theta[:, 3 : len(BASE)] = trace.load.inertia_kgm2, trace.load.gravity_Nm
    exact = Simulator([trace])
    if exact.is_linear(theta):
        (angle,) = exact.angles(theta, np.inf)
    else:
        shortest, longest = search.substep_s
        substep = longest_substep(theta, theta[:, 3], search.steps_per_radian, longest)
        substep = np.maximum(substep, shortest)
        angle = rollout(theta, trace.t, trace.command, substep_s=substep, threads=2)
    return np.asarray(np.mean(np.abs(angle - trace.position)[:, trace.used], axis=1))


def servos_at(points: Array, inertia: float | Array) -> Array:
    """Gains and latencies of servos at points of the unit cube.

    Args:
        points: Points of shape (N, 3): frequency and damping ratio (logarithmic) and latency, as
            shares of the ranges of a first guess.
        inertia: Inertia of the load in kg m2, a number or shape (..., 1).

    Returns:
        kp, kd and latency in SI units, shape (..., N, 3).
    """
    ranges = np.array([np.log(FREQUENCY_RAD_S), np.log(DAMPING_RATIO), LATENCY_S])
    scaled = ranges[:, 0] + points * np.diff(ranges, axis=1).T
    frequency, damping = np.exp(scaled[:, :2]).T
    kp = frequency**2 * inertia
    kd = 2 * damping * frequency * inertia
    return np.stack([kp, kd, np.broadcast_to(scaled[:, 2], kp.shape)], axis=-1)
