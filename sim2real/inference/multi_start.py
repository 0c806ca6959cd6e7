"""Which searches of a multi-start fit can still win."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cannot_win(
    active: NDArray[np.intp],
    points: Array,
    losses: Array,
    promised: Array,
    *,
    same: float = 0.1,
    behind: float = 30.0,
    optimism: float = 5.0,
) -> NDArray[np.bool_]:
    """Searches that approach the minimum of a better one, or stay behind the best one.

    To be given to ``least_squares.minimise`` as ``hopeless``.

    Args:
        active: Indices of the M searches that continue, of S.
        points: Where all searches are, in natural units, shape (S, F).
        losses: Their losses, shape (S,).
        promised: Decrease of the loss that each of ``active`` expects of its next step, shape (M,).
        same: Distance in natural units within which two searches approach one minimum.
        behind: Loss by which a search may stay above the best one.
        optimism: Multiple of the promised decrease that a search is granted.

    Returns:
        Which of ``active`` to give up, shape (M,).
    """
    rank = np.empty(losses.size, dtype=np.intp)
    rank[np.argsort(losses, kind="stable")] = np.arange(losses.size)
    near = np.abs(points[active, None] - points).max(axis=2) < same
    follows = (near & (rank < rank[active, None])).any(axis=1)
    reachable = losses[active] - optimism * np.maximum(promised, 0.5)
    return np.asarray(follows | (reachable > losses.min() + behind))
