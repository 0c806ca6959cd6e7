"""Which searches of a multi-start fit can still win."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def worth_following(
    active: NDArray[np.intp],
    position: Array,
    loss: Array,
    curvature: Array,
    gradient: Array,
    *,
    same: float = 0.1,
    behind: float = 60.0,
    optimism: float = 5.0,
) -> NDArray[np.intp]:
    """Searches that may still end below the best one, and do not follow another one.

    Args:
        active: Indices of the searches that continue, of S.
        position: Where each search is, in natural units, shape (S, F).
        loss: Its loss, shape (S,).
        curvature: Half the second derivatives of its loss, shape (S, F, F).
        gradient: Half the first derivatives of its loss, shape (S, F).
        same: Distance in natural units within which two searches approach one minimum.
        behind: Loss by which a search may stay above the best one.
        optimism: Multiple of the decrease of its quadratic model that a search is granted.

    Returns:
        Those of ``active`` that are worth continuing, ascending.
    """
    continuing = set(active.tolist())
    kept: list[int] = []
    seen: list[int] = []
    order = np.argsort(loss, kind="stable").tolist()
    for s in order:
        follows = any(np.abs(position[k] - position[s]).max() < same for k in seen)
        seen.append(s)
        if follows or s not in continuing:
            continue
        ridge = 1e-9 * np.diag(curvature[s]).max() + 1e-300
        matrix = curvature[s] + ridge * np.eye(gradient.shape[1])
        decrease = max(float(gradient[s] @ np.linalg.solve(matrix, gradient[s])), 1.0)
        if loss[s] - optimism * decrease < loss[order[0]] + behind:
            kept.append(s)
    return np.sort(np.array(kept, dtype=np.intp))
