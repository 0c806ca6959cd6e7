"""Levenberg-Marquardt minimisation of many bounded problems at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Index, Mask

OUTLIER_SD = 3.0
"""Residuals beyond this number of standard deviations are down-weighted."""
_DAMPING = 1e-6, 1e6
"""Smallest damping, and damping above which a search ends."""


@dataclass(frozen=True)
class Expansion:
    """Second-order expansion of minus the log-posterior of N problems, each about one point."""

    loss: Array  # value up to a constant, shape (N,); infinite where the simulation diverges
    slope: Array  # first derivatives, shape (N, F)
    curvature: Array  # second derivatives in the Gauss-Newton approximation, shape (N, F, F)
    aside: dict[str, Array]  # other results at the points by name, arrays of shape (N, ...)

    def replace(self, rows: Index, new: Expansion, chosen: Mask | slice = slice(None)) -> None:
        """Replace the rows (M,), in place, by the M chosen rows of another expansion."""
        for name in ("loss", "slope", "curvature"):
            getattr(self, name)[rows] = getattr(new, name)[chosen]
        for name, values in self.aside.items():
            values[rows] = new.aside[name][chosen]


Expand = Callable[[Array, Index], Expansion]
"""Function from points (M, F), in units, of the problems ``index`` (M,) to their expansions."""
Hopeless = Callable[[Index, Array, Array, Array], Mask]
"""Function from the active problems (M,), the points (N, F) and losses (N,) of all, and the gain
that each active one expects of an undamped step (M,), to a mask of those to stop (M,)."""


@dataclass(frozen=True)
class Minimum:
    """Result of a search."""

    x: Array  # the best points in units, shape (N, F)
    expansion: Expansion  # expansion about them
    converged: Mask  # whether no further step was expected to be significant, shape (N,)


def minimise(
    expand: Expand,
    start: Array,
    low: Array,
    high: Array,
    *,
    free: Mask | None = None,
    evaluations: int = 40,
    settled: float = 0.02,
    hopeless: Hopeless | None = None,
    losses: Callable[[Array, Index], Array] | None = None,
    look_every: int = 4,
) -> Minimum:
    """Minimise N problems by damped steps, with one joint evaluation per round.

    Source: Marquardt, SIAM Journal on Applied Mathematics 11 (1963) 431-441; a parameter whose step
    would leave its bounds is held at the bound. ``start``, ``low`` and ``high`` are in units, shape
    (N, F); ``free`` marks the places that hold a parameter. A search ends after ``evaluations``, or
    where the expected gain is below ``settled``; ``hopeless`` selects problems to stop every
    ``look_every`` evaluations. ``losses`` returns those of points (M, F) of the problems ``index``
    (M,), if they are cheaper than expansions; only points with a smaller loss are then expanded.
    """
    N = start.shape[0]
    free = np.ones(start.shape, dtype=bool) if free is None else free
    best = np.where(free, np.clip(start, low, high), start)
    damping = np.full(N, 1e-3)
    active, trial = np.arange(N), best.copy()
    current = expand(best, active)
    converged = np.zeros(N, dtype=bool)
    better = np.ones(N, dtype=bool)
    for count in range(1, evaluations + 1):
        if count > 1 and losses is None:
            proposal = expand(trial[active], active)
            better = proposal.loss < current.loss[active]
            current.replace(active[better], proposal, better)
        elif count > 1 and losses is not None:
            better = losses(trial[active], active) < current.loss[active]
            if better.any():
                current.replace(active[better], expand(trial[active[better]], active[better]))
        accepted, rejected = active[better], active[~better]
        best[accepted] = trial[accepted]
        damping[accepted] = np.maximum(damping[accepted] / 5, _DAMPING[0])
        damping[rejected] *= 8
        step, gain = _step(current, best, (low, high), free, damping, active)
        worth = (gain > settled) & (damping[active] < _DAMPING[1])
        converged[active] = ~worth
        bounded = np.clip(best[active] + step, low[active], high[active])
        trial[active] = np.where(free[active], bounded, best[active])
        active = active[worth]
        if hopeless is not None and active.size and count % look_every == 0:
            # Parameters with the same effect leave the curvature singular without damping.
            promised = _step(current, best, (low, high), free, np.full(N, 1e-12), active)[1]
            active = active[~hopeless(active, best, current.loss, promised)]
        if not active.size:
            break
    return Minimum(best, current, converged)


def _step(
    current: Expansion,
    best: Array,
    box: tuple[Array, Array],
    free: Mask,
    damping: Array,
    rows: Index,
    *,
    longest_step: float = 3.0,
    doublings: int = 60,
) -> tuple[Array, Array]:
    """Next step of each problem in units, shape (M, F), and its expected gain, shape (M,)."""
    x, low, high = best[rows], box[0][rows], box[1][rows]
    slope, normal = current.slope[rows], current.curvature[rows]
    held = ~free[rows]
    with np.errstate(invalid="ignore"):
        margin = 1e-9 * (high - low)
    held |= (x <= low + margin) & (slope > 0)
    held |= (x >= high - margin) & (slope < 0)
    diagonal = np.einsum("nff->nf", normal)
    held |= diagonal <= 1e-12 * diagonal.max(axis=1, initial=0.0, keepdims=True) + 1e-300
    moving, factor = ~held, 1 + damping[rows, None]
    matrix = normal * (moving[:, :, None] & moving[:, None])
    step, gain = np.zeros_like(x), np.zeros(len(x))
    todo = np.arange(len(x))
    for _ in range(doublings):
        size = factor[todo] * diagonal[todo]
        np.einsum("nff->nf", matrix)[todo] = np.where(moving[todo], size, 1.0)
        slopes, at = slope[todo], x[todo]
        move = _solved(matrix[todo], np.where(moving[todo], -slopes, 0.0))
        longest = np.abs(move).max(axis=1, initial=0.0, keepdims=True)
        move *= np.minimum(1.0, longest_step / np.maximum(longest, 1e-300))
        # Rounding may leave a held parameter outside its bound, by what no damping shrinks.
        move = np.where(moving[todo], np.clip(at + move, low[todo], high[todo]) - at, 0.0)
        expected = -np.einsum("nf,nf->n", slopes, move)
        expected -= 0.5 * np.einsum("nf,nfg,ng->n", move, normal[todo], move)
        uphill = expected < 0  # a step cut at its bounds; more damping turns it towards the slope
        step[todo[~uphill]], gain[todo[~uphill]] = move[~uphill], expected[~uphill]
        todo = todo[uphill]
        if not todo.size:
            break
        factor[todo] *= 2
    return step, gain


def _solved(matrix: Array, right: Array) -> Array:
    """Solutions of symmetric systems (M, F, F), of least norm if one is singular; (M, F)."""
    try:
        return np.asarray(np.linalg.solve(matrix, right[:, :, None])[:, :, 0])
    except np.linalg.LinAlgError:
        finite = np.isfinite(matrix).all(axis=(1, 2))
        inverse = np.full_like(matrix, np.nan)
        inverse[finite] = np.linalg.pinv(matrix[finite], hermitian=True)
        return np.asarray(np.einsum("nfg,ng->nf", inverse, right))


def cannot_win(
    active: Index,
    points: Array,
    losses: Array,
    promised: Array,
    *,
    same: float = 0.1,
    behind: float = 30.0,
    optimism: float = 5.0,
) -> Mask:
    """Searches that approach the minimum of a better one, or cannot reach the best loss.

    For the argument ``hopeless`` of ``minimise``: of S searches the M ``active`` ones, current
    points (S, F) in natural units, losses (S,), and the decrease ``promised`` by the next step
    (M,), of which a multiple, ``optimism``, is assumed to remain.
    """
    rank = np.empty(losses.size, dtype=np.intp)
    rank[np.argsort(losses, kind="stable")] = np.arange(losses.size)
    near = np.abs(points[active, None] - points).max(axis=2) < same
    follows = (near & (rank < rank[active, None])).any(axis=1)
    reachable = losses[active] - optimism * np.maximum(promised, 0.5)
    return np.asarray(follows | (reachable > losses.min() + behind))


def rms(errors: Sequence[Array]) -> float:
    """Root mean square over all arrays; 0 where there is no sample, infinite where it overflows."""
    count = sum(error.size for error in errors)
    with np.errstate(over="ignore"):  # of a diverged simulation
        return float(np.sqrt(sum(np.sum(error**2) for error in errors) / max(count, 1)))


def robust_loss(error: Array, scale: float) -> Array:
    """Soft L1 loss of residuals (..., n), nearly their sum of squares if none exceeds ``scale``."""
    return np.asarray(np.sum(np.sqrt(1 + (error / scale) ** 2) - 1, axis=-1)) * 2 * scale**2


def robust_scale(error: Array) -> float:
    """Standard deviation, robust to 10 % of outliers and always above 0.

    Solves mean(min((error / scale)^2, 9)) = 0.995, its value for normal errors: Huber's proposal
    2 (Annals of Mathematical Statistics 35 (1964) 73-101) with the limit at 3 standard deviations.
    """
    scale = max(float(np.sqrt(np.mean(error**2))), 1e-9)
    for _ in range(60):
        limited = np.minimum((error / scale) ** 2, OUTLIER_SD**2)
        scale = max(scale * float(np.sqrt(np.mean(limited) / 0.995)), 1e-9)
    return scale
