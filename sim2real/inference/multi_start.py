"""Stopping rule for searches of a multi-start fit."""

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
    """Searches that approach the minimum of a better one, or cannot reach the best loss.

    For the argument ``hopeless`` of ``least_squares.minimise``.

    Args:
        active: Indices of the M active ones of S searches.
        points: Current points of all searches, in natural units, shape (S, F).
        losses: Their losses, shape (S,).
        promised: Decrease of the loss expected from the next step of each active search, (M,).
        same: Distance in natural units below which two searches approach the same minimum.
        behind: Largest difference to the best loss at which a search continues.
        optimism: Assumed remaining decrease as a multiple of ``promised``.

    Returns:
        Mask of the active searches to stop, shape (M,).
    """
    rank = np.empty(losses.size, dtype=np.intp)
    rank[np.argsort(losses, kind="stable")] = np.arange(losses.size)
    near = np.abs(points[active, None] - points).max(axis=2) < same
    follows = (near & (rank < rank[active, None])).any(axis=1)
    reachable = losses[active] - optimism * np.maximum(promised, 0.5)
    return np.asarray(follows | (reachable > losses.min() + behind))
