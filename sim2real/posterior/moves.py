"""How an ensemble of walkers moves."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FREEDOM, SCALE = 5.0, 1.1
"""Degrees of freedom and size of the proposals: heavier tails than any normal distribution."""
SHARES = (0.6, 0.2, 0.2)
"""Share of steps that are independent proposals, stretches, and differences of walkers."""


def moves(free: int) -> list[tuple[Any, float]]:
    """Moves of ``emcee`` for F standardised coordinates, each with its share of the steps.

    Where the posterior is nearly normal an independent proposal from the Laplace approximation is
    mostly accepted and forgets where it came from; where it is not, the moves that follow the
    ensemble itself take over. Sources: Tierney, Annals of Statistics 22 (1994) 1701-1728
    (independence chains, mixtures of moves); Goodman and Weare, Communications in Applied
    Mathematics and Computational Science 5 (2010) 65-80; ter Braak, Statistics and Computing 16
    (2006) 239-249.
    """
    from emcee.moves import DEMove, MHMove, StretchMove  # type: ignore[import-untyped]

    each = (MHMove(independent, ndim=free), StretchMove(), DEMove())
    return list(zip(each, SHARES, strict=True))


def independent(
    coordinates: Array,
    random: np.random.RandomState,  # noqa: NPY002 - the generator that emcee has
) -> tuple[Array, Array]:
    """New coordinates (W, F) from a Student distribution about the optimum, and their log-ratio."""
    W, F = coordinates.shape
    tail = np.sqrt(random.chisquare(FREEDOM, size=(W, 1)) / FREEDOM)
    new = SCALE * random.normal(size=(W, F)) / tail
    return new, _log_student(coordinates) - _log_student(new)


def _log_student(w: Array) -> Array:
    square = np.sum((w / SCALE) ** 2, axis=1)
    return np.asarray(-0.5 * (FREEDOM + w.shape[1]) * np.log1p(square / FREEDOM))
