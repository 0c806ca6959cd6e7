"""Search for the parameters of a servo: many starts at once, robust to outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sim2real.arrays import Array, Index
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.inference.least_squares import Expansion, cannot_win, minimise, rms, robust_scale
from sim2real.inference.parameters import apart, column
from sim2real.servo.parameters import LOSSES, ROTOR
from sim2real.servo.trace import Trace

_SAME_SCALE = 0.05
"""Relative change of the scale of the residual below which rounds end."""


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
    most: int = 8,
) -> Fit:
    """Fit the free parameters of a servo from several starts (S, P).

    Levenberg-Marquardt searches run simultaneously; those that approach the minimum of a better one
    or fall ``behind`` it in log-likelihood end. The likelihood counts correlated residuals as fewer
    samples, so that misfit does not outweigh the prior; the scale of the residual is estimated
    again after each round, and rounds end where it stays the same.

    Args:
        problem: The problem.
        starts: Servos from which searches start.
        rounds: Largest number of rounds.
        first: Largest number of evaluations of a search in the first round, with long sub-steps.
        later: The same in later rounds.
        last: The same of the best search alone, in the end.
        effort: Multiplies these three.
        behind: See above.
        rival: Another fit, and by how much the first round must go below its loss: else the fit
            ends there, not at its minimum.
        rng: Generator for the neighbours by which ``most`` minima are ordered (``robust_order``)
            where a servo may stick or just not; None for the order of their losses.
        most: See ``rng``.
    """
    x = problem.searched(starts)
    error = problem.residuals(x)
    noise = _noise(problem, error[np.argmin(np.mean(np.abs(error), axis=1))])
    for number in range(rounds):
        evaluations = round(effort * (later if number else first))
        x, loss, _ = search(problem, x, noise, evaluations, rough=not number, behind=behind)
        error = problem.residuals(x[:1])
        scale, noise = noise[0], _noise(problem, error[0])
        x = x[loss < loss[0] + behind] if number else x
        x = x[apart(x, 0.1)]
        if number and abs(noise[0] / scale - 1) < _SAME_SCALE:
            break
        lower = rival[0].loss(*noise) - problem.loss(x[:1], error, *noise)[0] if rival else 0.0
        if rival is not None and not number and lower < rival[1]:
            x, last = x[:1], 0
            break
    if rng is not None and len(x) > 1:
        x = x[robust_order(problem, x[:most], noise, rng)]
    best, _, converged = search(problem, x[:1], noise, round(effort * last), settled=1e-6)
    x = np.concatenate([best, x[1:]])
    loss = problem.loss(x, problem.residuals(x), *noise)
    (error,), (slopes,) = problem.slopes(best, rough=False)
    return Fit(problem, x[0], error, slopes, *noise, converged, x[1:], loss[1:] - loss[0])


def _noise(problem: ServoProblem, error: Array) -> tuple[float, float]:
    """Scale of a residual (n,) in rad, and its inflation."""
    return robust_scale(error), problem.inflation(error)


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
    ends where it expects a decrease of half the loss below ``settled``.

    Returns:
        The points in ascending order of their losses, the losses (S,), and whether the search for
        the best point converged.
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
    order = np.argsort(minimum.expansion.loss)
    loss = 2 * minimum.expansion.loss[order]
    return minimum.x[order], loss, bool(minimum.converged[order[0]])


def robust_order(
    problem: ServoProblem,
    x: Array,
    noise: tuple[float, float],
    rng: np.random.Generator,
    *,
    neighbours: int = 128,
    distance: float = 0.1,
) -> Index:
    """Indices of minima (M, F) by the mean loss of their neighbours, smallest first.

    Neighbours differ in rotor inertia and losses by ``distance``, a share of the prior's standard
    deviation. A narrow minimum owes its small loss to a coincidence, for instance of the moment at
    which the shaft sticks, and predicts other motions badly; so the expected loss of uncertain
    parameters is what counts (robust optimisation: Beyer and Sendhoff, Computer Methods in Applied
    Mechanics and Engineering 196 (2007) 3190-3218, sec. 2.2). ``noise`` as of ``search``.
    """
    varied = [k for k, name in enumerate(problem.names) if name in (ROTOR, *LOSSES)]
    sd = column(problem.parameters, "prior_sd")[varied] / problem.unit[varied]
    offset = distance * sd * rng.standard_normal((neighbours, len(varied)))
    low, high = problem.box
    means = np.empty(len(x))
    for k, minimum in enumerate(x):
        nearby = np.tile(minimum, (neighbours, 1))
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
