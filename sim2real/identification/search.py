"""Search for the parameters of a servo: many starts at once, robust to outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.inference.least_squares import Expansion, cannot_win, minimise, robust_scale
from sim2real.inference.parameters import column
from sim2real.servo.parameters import LOSSES, ROTOR
from sim2real.servo.trace import Trace

_SAME_SCALE = 0.05
"""Relative change of the scale of the residual below which rounds end."""


def fit(
    problem: ServoProblem,
    starts: Array,
    *,
    rounds: int = 4,
    first: int = 20,
    later: int = 10,
    last: int = 40,
    behind: float = 30.0,
    least_gain: float = 0.0,
    rng: np.random.Generator | None = None,
    most: int = 8,
) -> Fit:
    """Fit the free parameters of a servo from several starts (S, P).

    Levenberg-Marquardt searches run simultaneously; those that approach the minimum of a better one
    or fall ``behind`` it in log-likelihood end. The likelihood counts correlated residuals as fewer
    samples, so that misfit does not outweigh the prior; the scale of the residual is estimated
    again between rounds.

    Args:
        problem: The problem.
        starts: Servos from which searches start.
        rounds: Largest number of rounds.
        first: Largest number of evaluations of a search in the first round, with long sub-steps.
        later: The same in later rounds.
        last: The same of the best search alone, in the end.
        behind: See above.
        least_gain: Decrease of half the loss, from the first start, without which a few steps of
            all searches are enough.
        rng: Generator for the neighbours by which ``most`` minima are ordered (``robust_order``)
            where a servo may stick or just not; None for the order of their losses.
        most: See ``rng``.
    """
    x = problem.searched(starts)
    error = problem.residuals(x)
    error = error[np.argmin(np.mean(np.abs(error), axis=1))]
    scale = inflation = 1.0
    for number in range(rounds):
        before = scale
        scale, inflation = robust_scale(error), problem.inflation(error)
        x, loss, gain, _ = search(
            problem,
            x,
            (scale, inflation),
            later if number else first,
            rough=not number,
            behind=behind,
            least_gain=0.0 if number else least_gain,
        )
        error = problem.residuals(x[:1])[0]
        if not number and gain < least_gain:
            return _result(problem, x[:1], loss[:1], (scale, inflation), converged=True)
        kept = loss < loss[0] + behind
        x = x[kept] if number else x
        if number and abs(scale / before - 1) < _SAME_SCALE:
            break
    noise = robust_scale(error), problem.inflation(error)
    x = x[_distinct(x)]
    if rng is not None and len(x) > 1:
        x = x[robust_order(problem, x[:most], noise, rng)]
    best, _, _, converged = search(problem, x[:1], noise, last, settled=1e-6)
    x = np.concatenate([best, x[1:]])
    loss = problem.loss(x, problem.residuals(x), *noise)
    return _result(problem, x, loss, noise, converged=converged)


def search(
    problem: ServoProblem,
    x: Array,
    noise: tuple[float, float],
    evaluations: int,
    *,
    rough: bool = False,
    behind: float = 30.0,
    least_gain: float = 0.0,
    patience: int = 8,
    settled: float = 1e-3,
) -> tuple[Array, Array, float, bool]:
    """Search from points (S, F), for a scale of the residual in rad and its inflation (``noise``).

    As of ``fit``, up to ``patience`` evaluations without ``least_gain``; residuals, too, have the
    longer sub-steps of derivatives if ``rough``. A search ends where it expects a decrease of half
    the loss below ``settled``.

    Returns:
        The points in ascending order of their losses, the losses (S,), the decrease of half the
        loss from the first start, and whether the search for the best point converged.
    """
    latest: dict[int, Array] = {}
    first: list[float] = []

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

    def hopeless(active: Index, points: Array, losses: Array, promised: Array) -> Mask:
        first.append(float(losses[0]))
        if len(first) == patience and first[0] - losses.min() < least_gain:
            return np.ones(active.size, dtype=bool)
        return cannot_win(active, points, losses, promised, behind=behind)

    minimum = minimise(
        expand,
        x,
        *(np.tile(end, (len(x), 1)) for end in problem.box),
        evaluations=evaluations,
        settled=settled,
        hopeless=hopeless,
        losses=losses,
        look_every=1,
    )
    loss = minimum.expansion.loss
    gain = first[0] - float(loss.min()) if first else 0.0
    order = np.argsort(loss)
    return minimum.x[order], 2 * loss[order], gain, bool(minimum.converged[order[0]])


def _distinct(x: Array, *, same: float = 0.1) -> Index:
    """Indices of the minima (M, F) that differ from all before them."""
    kept = [0]
    for k in range(1, len(x)):
        if (np.abs(x[kept] - x[k]).max(axis=1) > same).all():
            kept.append(k)
    return np.array(kept)


def shortlist(problem: ServoProblem, starts: Array, count: int) -> Array:
    """The first of servos (S, P) and those with the smallest errors, ``count`` in all."""
    window = max((trace.window() for trace in problem.traces), key=Trace.activity)
    windowed = replace(problem, traces=[window])
    size = np.mean(np.abs(windowed.residuals(windowed.searched(starts), rough=True)), axis=1)
    size[0] = 0.0
    return np.asarray(starts[np.argsort(size)[:count]])


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


def continued(best: Fit, traces: Sequence[Trace], *, effort: float = 1.0) -> Fit:
    """Fit the same parameters to more recordings of the joint, from all minima of a fit.

    ``effort`` multiplies the largest number of evaluations.
    """
    problem = replace(best.problem, traces=traces)
    first, later, last = (round(effort * size) for size in (10, 10, 40))
    return fit(problem, best.minima, rounds=3, first=first, later=later, last=last)


def point_fit(problem: ServoProblem, row: Array) -> Fit:
    """The servo ``row`` (P,) as a fit, without a search."""
    x = problem.searched(row[None])
    error = problem.residuals(x)[0]
    noise = robust_scale(error), problem.inflation(error)
    return _result(problem, x, np.zeros(1), noise, converged=True)


def errors_of(row: Array, traces: Sequence[Trace]) -> tuple[Array, ...]:
    """Simulated minus measured angles of a servo (P,) at the used samples of each trace."""
    if not traces:
        return ()
    problem = ServoProblem(traces, row, ())
    return problem.by_trace(problem.residuals(np.zeros((1, 0)))[0])


def _result(
    problem: ServoProblem, x: Array, loss: Array, noise: tuple[float, float], *, converged: bool
) -> Fit:
    """The fit at the first of some minima (M, F)."""
    (error,), (slopes,) = problem.slopes(x[:1], rough=False)
    return Fit(problem, x[0], error, slopes, *noise, converged, x[1:], loss[1:] - loss[0])
