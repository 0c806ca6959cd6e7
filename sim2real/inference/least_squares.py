"""The fitter: Levenberg-Marquardt on many problems in step, within bounds.

What is fitted says, at points of any number of problems, how well each fits, the slope and the
curvature (``Expansion``); how it knows, by one launch of simulations or one row at a time, is its
own affair. ``expansion`` makes one of residuals and their derivatives, robust to wild samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

SETTLED = 0.02
"""Gain in log-likelihood below which a step is not worth making."""
OUTLIER_SD = 3.0
"""Residuals beyond so many standard deviations lose weight."""


@dataclass(frozen=True)
class Expansion:
    """Minus the logarithm of the likelihood (and prior) of N problems about a point of each.

    Attributes:
        loss: It, up to a constant, shape (N,); infinite where the simulation is lost.
        slope: Its derivatives, shape (N, F).
        curvature: Its second derivatives, by Gauss and Newton, shape (N, F, F).
        aside: What else is known at the points, arrays that begin with N, by name.
    """

    loss: Array
    slope: Array
    curvature: Array
    aside: dict[str, Array]

    def replaced(self, rows: Index, by: Expansion, taken: Mask) -> Expansion:
        """This one with ``rows`` set to those of another that are ``taken``; in place."""
        for mine, other in zip(self._arrays(), by._arrays(), strict=True):
            mine[rows[taken]] = other[taken]
        return self

    def _arrays(self) -> list[Array]:
        return [self.loss, self.slope, self.curvature, *self.aside.values()]


Expand = Callable[[Array, Index], Expansion]
"""From points (M, F), in units, of the problems ``index`` (M,) to their expansions."""


Hopeless = Callable[[Index, Array, Array, Array], Mask]
"""From the problems still searched (M,), the points (N, F) and losses (N,) of all, and what an
undamped step promises each searched one to gain (M,), to those that are given up (M,)."""


@dataclass(frozen=True)
class Minimum:
    """Where a search ended.

    Attributes:
        x: The best points in units, shape (N, F).
        expansion: About them.
        converged: Whether no step was left that was worth making, shape (N,).
    """

    x: Array
    expansion: Expansion
    converged: Mask


def minimise(
    expand: Expand,
    start: Array,
    low: Array,
    high: Array,
    *,
    free: Mask | None = None,
    evaluations: int = 40,
    settled: float = SETTLED,
    hopeless: Hopeless | None = None,
    losses: Callable[[Array, Index], Array] | None = None,
    progress: Callable[[float], None] = lambda share: None,
    look_every: int = 4,
    least_damping: float = 1e-6,
    most_damping: float = 1e6,
) -> Minimum:
    """Fit N problems, each by its own damped steps, all in one evaluation a round.

    Source: Marquardt, SIAM Journal on Applied Mathematics 11 (1963) 431-441; a parameter at a bound
    that it is pushed against is held.

    Args:
        expand: What is fitted.
        start: Where to begin, in units, shape (N, F).
        low: Smallest values, likewise.
        high: Largest values, likewise.
        free: Places that hold a parameter, shape (N, F); all where None.
        evaluations: Most of each problem.
        settled: Expected gain below which a step is not worth making.
        hopeless: Which problems are given up; asked every ``look_every`` evaluations.
        losses: Losses of points (M, F) of the problems ``index`` (M,), where they are cheaper than
            expansions; only points that are better than the last are then expanded.
        progress: Called with the share that is done.
        look_every: Evaluations between two calls of ``hopeless``.
        least_damping: Damping is never less.
        most_damping: Problems whose damping exceeds it are given up.
    """
    N = start.shape[0]
    free = np.ones(start.shape, dtype=bool) if free is None else free
    best = np.where(free, np.clip(start, low, high), start)
    damping = np.full(N, 1e-3)
    active, trial = np.arange(N), best.copy()
    at = expand(best, active)
    converged = np.zeros(N, dtype=bool)
    better = np.ones(N, dtype=bool)
    for made in range(1, evaluations + 1):
        if made > 1 and losses is None:
            then = expand(trial[active], active)
            better = then.loss < at.loss[active]
            at.replaced(active, then, better)
        elif made > 1 and losses is not None:
            better = losses(trial[active], active) < at.loss[active]
            rows = active[better]
            if rows.size:
                at.replaced(rows, expand(trial[rows], rows), np.ones(rows.size, dtype=bool))
        won, lost = active[better], active[~better]
        best[won] = trial[won]
        damping[won] = np.maximum(damping[won] / 5, least_damping)
        damping[lost] *= 8
        step, gain = _step(at, best, (low, high), free, damping, active)
        worth = (gain > settled) & (damping[active] < most_damping)
        converged[active] = ~worth
        trial[active] = best[active] + step
        active = active[worth]
        if hopeless is not None and active.size and made % look_every == 0:
            promised = _step(at, best, (low, high), free, np.zeros(N), active)[1]
            active = active[~hopeless(active, best, at.loss, promised)]
        progress(made / evaluations)
        if not active.size:
            break
    return Minimum(best, at, converged)


def _step(
    at: Expansion,
    best: Array,
    box: tuple[Array, Array],
    free: Mask,
    damping: Array,
    rows: Index,
    *,
    largest_step: float = 3.0,
) -> tuple[Array, Array]:
    """Next step of each problem, shape (M, F), and the gain that is expected of it, shape (M,)."""
    x, low, high = best[rows], box[0][rows], box[1][rows]
    slope, normal = at.slope[rows], at.curvature[rows]
    held = ~free[rows]
    with np.errstate(invalid="ignore"):
        margin = 1e-9 * (high - low)
    held |= (x <= low + margin) & (slope > 0)
    held |= (x >= high - margin) & (slope < 0)
    diagonal = np.einsum("nff->nf", normal)
    held |= diagonal <= 1e-12 * diagonal.max(axis=1, initial=0.0, keepdims=True) + 1e-300
    moving = ~held
    matrix = normal * (moving[:, :, None] & moving[:, None])
    size = np.where(moving, diagonal * (1 + damping[rows, None]), 1.0)
    np.einsum("nff->nf", matrix)[...] = size
    step = np.linalg.solve(matrix, np.where(moving, -slope, 0.0)[:, :, None])[:, :, 0]
    longest = np.abs(step).max(axis=1, initial=0.0, keepdims=True)
    step *= np.minimum(1.0, largest_step / np.maximum(longest, 1e-300))
    step = np.where(free[rows], np.clip(x + step, low, high) - x, 0.0)
    gain = -np.einsum("nf,nf->n", slope, step)
    gain -= 0.5 * np.einsum("nf,nfg,ng->n", step, normal, step)
    return np.asarray(step), np.asarray(gain)


def central(
    simulate: Callable[[Array], Array], x: Array, size: Array, low: Array, high: Array
) -> tuple[Array, Array]:
    """What is simulated at a point, and its derivatives by central differences, in one batch.

    Args:
        simulate: From points (M, F) to rows (M, n).
        x: The point, shape (F,).
        size: Steps, shape (F,); those that would leave the bounds are cut.
        low: Smallest values, shape (F,).
        high: Largest values, shape (F,).

    Returns:
        The row (n,) and its derivatives (n, F).
    """
    F = x.size
    ahead, back = np.minimum(x + size, high), np.maximum(x - size, low)
    own = np.eye(F, dtype=bool)
    points = np.concatenate([x[None], np.where(own, ahead, x), np.where(own, back, x)])
    rows = simulate(points)
    change = rows[1 : F + 1] - rows[F + 1 :]
    return rows[0], np.asarray((change / (ahead - back)[:, None]).T)


def expansion(error: Array, slope: Array, scale: float = np.inf) -> Expansion:
    """That of one sum of squares, or of one soft L1 loss, halved.

    Args:
        error: Residuals, shape (n,), in standard deviations, or whatever the loss shall be in.
        slope: Their derivatives, shape (n, F).
        scale: Size of a residual from which it loses weight; infinite for the sum of squares.
    """
    ratio = 1 + (error / scale) ** 2
    loss = 0.5 * robust_loss(error, scale)
    bent = (slope / ratio[:, None] ** 1.5).T @ slope
    steep = (error / np.sqrt(ratio)) @ slope
    return Expansion(np.array([loss]), steep[None], bent[None], {})


def stacked(expansions: Sequence[Expansion]) -> Expansion:
    """Expansions of N problems, one after the other."""
    loss, slope, curvature = (
        np.concatenate([getattr(e, name) for e in expansions])
        for name in ("loss", "slope", "curvature")
    )
    return Expansion(loss, slope, curvature, {})


def minimise_robustly(
    residuals: Callable[[Array], tuple[Array, Array]],
    start: Array,
    low: Array,
    high: Array,
    *,
    rounds: int = 3,
    evaluations: int = 60,
    same_scale: float = 0.05,
    settled: float = 1e-9,
) -> tuple[Array, bool]:
    """Least squares, first plain, then robust (soft L1), its scale taken anew until it stays.

    Args:
        residuals: Residuals (n,) and their derivatives (n, F) at a point (F,).
        start: Where to begin, in units, shape (F,).
        low: Smallest values, likewise.
        high: Largest values, likewise.
        rounds: Most robust rounds after the plain one.
        evaluations: Most evaluations in one round.
        same_scale: Relative change of the scale below which it counts as the same.
        settled: Expected gain, relative to the scale, below which a step is not worth making.

    Returns:
        The minimum, shape (F,), and whether the search converged to it.
    """
    point, converged, scale = start, True, 0.0
    known: dict[bytes, tuple[Array, Array]] = {}

    def at(x: Array) -> tuple[Array, Array]:
        key = x.tobytes()
        if key not in known:
            known.clear()
            known[key] = residuals(x)
        return known[key]

    for number in range(rounds + 1):
        before, scale = scale, robust_scale(at(point)[0])
        if number > 1 and abs(scale / before - 1) < same_scale:
            break
        limit = OUTLIER_SD if number else np.inf

        def expand(x: Array, _: Index, limit: float = limit, scale: float = scale) -> Expansion:
            error, slope = at(x[0])
            return expansion(error / scale, slope / scale, limit)

        found = minimise(
            expand,
            point[None],
            low[None],
            high[None],
            evaluations=evaluations,
            settled=settled,
        )
        point, converged = found.x[0], bool(found.converged[0])
    return point, converged


def rms(errors: Sequence[Array]) -> float:
    """Root mean square over all arrays; 0 where there is no sample, infinite where it overflows."""
    count = sum(error.size for error in errors)
    with np.errstate(over="ignore"):  # of a simulation that has run away
        return float(np.sqrt(sum(np.sum(error**2) for error in errors) / max(count, 1)))


def robust_loss(error: Array, scale: float) -> float:
    """Soft L1 loss of residuals, about their sum of squares where none is beyond ``scale``."""
    if np.isinf(scale):
        return float(np.sum(error**2))
    return float(np.sum(np.sqrt(1 + (error / scale) ** 2) - 1)) * 2 * scale**2


def robust_scale(error: Array) -> float:
    """Standard deviation that a tenth of wild samples cannot spoil, never 0.

    Solves mean(min((error / scale)^2, 9)) = 0.995, its value for normal errors: Huber's proposal
    2 (Annals of Mathematical Statistics 35 (1964) 73-101) with the limit at 3 standard deviations.
    """
    scale = max(float(np.sqrt(np.mean(error**2))), 1e-9)
    for _ in range(60):
        limited = np.minimum((error / scale) ** 2, OUTLIER_SD**2)
        scale = max(scale * float(np.sqrt(np.mean(limited) / 0.995)), 1e-9)
    return scale


def added(expansions: list[Expansion]) -> Expansion:
    """The expansion of several independent parts that share their points."""
    first, *rest = expansions
    for other in rest:
        first = replace(
            first,
            loss=first.loss + other.loss,
            slope=first.slope + other.slope,
            curvature=first.curvature + other.curvature,
        )
    return first
