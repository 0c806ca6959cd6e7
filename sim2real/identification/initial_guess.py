"""Starting point of a fit: a search over frequency, damping and latency."""

from __future__ import annotations

from collections.abc import Sequence

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


_CANDIDATES, _ELITE = 1024, 16
"""Number of servos in the first round, and of the best ones, about which further ones are drawn."""
_SPREADS = (0.1, 0.04, 0.015)
"""Standard deviations of candidates about the best ones in each round, as shares of the ranges."""
_RIVAL_ERROR = 1.03
"""Largest error of a rival, relative to the smallest error."""
_RIVAL_DISTANCE, _MOST_RIVALS = 0.08, 4
"""Smallest difference of a rival's gain, as a share of the range, and largest number of rivals."""
_STEPS_PER_RADIAN = 6.0
"""Sub-steps per radian of the fastest mode of a candidate."""
_SUBSTEP_S = (1e-3, 4e-3)
"""Shortest and longest sub-step; faster modes of strongly damped candidates decay within the
shortest one."""


def first_guess(traces: Sequence[Trace], rng: np.random.Generator) -> tuple[Array, Array]:
    """Parameters of a servo that approximately fits the recordings, and of very different rivals.

    Simulates a low-discrepancy set of servos over the segment with most motion in one batch, then,
    in a few narrower rounds, others around the best of them (the cross-entropy method: Rubinstein,
    Methodology and Computing in Applied Probability 1 (1999) 127-190).

    Args:
        traces: The recorded joint, one trace per recording.
        rng: Generator for the candidates.

    Returns:
        The best candidate, shape (P,), and rivals with nearly the same error but very different
        gains, shape (R, P): none if the recordings determine the gain.
    """
    windows = [trace.window(WINDOW_S) for trace in traces]
    moving = [window for window in windows if window.moves() and window.used.any()]
    trace = max(moving or [trace for trace in traces if trace.used.any()], key=Trace.activity)
    points = kronecker(_CANDIDATES, 3, rng)
    error = _errors(points, trace)
    for spread in _SPREADS:
        best = np.argsort(error)[:_ELITE]
        points, error = points[best], error[best]
        around = np.repeat(points, _CANDIDATES // (4 * _ELITE), axis=0)
        drawn = np.clip(around + spread * rng.standard_normal(around.shape), 0.0, 1.0)
        error = np.append(error, _errors(drawn, trace))
        points = np.vstack([points, drawn])
    order = np.argsort(error)
    equal = order[error[order] < _RIVAL_ERROR * error[order[0]]]
    chosen = [equal[0]]
    for candidate in equal[1:]:
        distance = np.abs(points[chosen, 0] - points[candidate, 0]).min()
        if distance > _RIVAL_DISTANCE and len(chosen) <= _MOST_RIVALS:
            chosen.append(candidate)
    rows = np.array([plain_row(*x) for x in servos_at(points[chosen], trace.load.inertia_kgm2)])
    return rows[0], rows[1:]


def _errors(points: Array, trace: Trace) -> Array:
    """Mean absolute error in rad of the servos at ``points`` (N, 3), shape (N,)."""
    theta = np.zeros((points.shape[0], len(COLUMNS)))
    theta[:, :3] = servos_at(points, trace.load.inertia_kgm2)
    theta[:, 3 : len(BASE)] = trace.load.inertia_kgm2, trace.load.gravity_Nm
    exact = Simulator([trace])
    if exact.is_linear(theta):
        (angle,) = exact.angles(theta, np.inf)
    else:
        shortest, longest = _SUBSTEP_S
        substep = longest_substep(theta, theta[:, 3], _STEPS_PER_RADIAN, longest)
        step = np.maximum(substep, shortest)
        angle = rollout(theta, trace.t, trace.command[:, None], substep_s=step, threads=2)[:, :, 0]
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
