"""Where fits may begin: at sizes that an effect may well have, if that promises more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.inference.coordinates import Coordinates
from sim.inference.linear_fit import Fit, Slope
from sim2real.inference.selection import Members

Array = NDArray[np.float64]

_JUMPS = (-2.0, 2.0, 6.0)
"""Sizes from which a search for an effect may begin, in steps of its derivative."""


class Problem(Protocol):
    """What is asked of swims (``twin_search.TwinSwims``)."""

    coordinates: Coordinates

    def rows(self, points: Array) -> Array:
        """Weighted errors at points (E, F)."""

    def judged(self, members: Members, x: Array, rows: Array, near: Slope) -> tuple[float, Array]:
        """Loss at a point, and the step to where it is least."""

    def linear(self, members: Members, fit: Fit) -> Fit:
        """Where that step would end."""


def jumped(problem: Problem, begun: Sequence[tuple[Members, Fit]]) -> list[tuple[Members, Fit]]:
    """Starts from sizes that an effect of one number may have, where they promise more."""
    trials, of = [], []
    for k, (members, fit) in enumerate(begun):
        for effect in members:
            own = problem.coordinates.of_effect(effect)
            if len(own) == 1 and fit.x[own[0]] == 0.0:
                column = problem.coordinates.columns[own[0]]
                for size in _JUMPS:
                    x = fit.x.copy()
                    x[own[0]] = np.clip(size * column.step, column.low, column.high)
                    trials.append(x)
                    of.append(k)
    if not trials:
        return list(begun)
    rows = problem.rows(np.array(trials))
    out = list(begun)
    best = [problem.linear(m, f).loss for m, f in begun]
    for x, row, k in zip(trials, rows, of, strict=True):
        members, fit = begun[k]
        loss, _ = problem.judged(members, x, row, fit.near)
        there = Fit(x, row, loss, fit.near)
        promised = problem.linear(members, there).loss
        if promised < best[k] and loss < out[k][1].loss:
            best[k], out[k] = promised, (members, there)
    return out


__all__ = ["jumped"]
