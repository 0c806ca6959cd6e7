"""Starts of fits at other sizes of an effect, where the linear model predicts less loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from sim.inference.coordinates import Coordinates
from sim.inference.linear_fit import Fit, Slope
from sim2real.arrays import Array
from sim2real.inference.selection import Members

_JUMPS = (-2.0, 2.0, 6.0)
"""Sizes of an effect that a fit may start from, in steps of its derivative."""


class Problem(Protocol):
    """Methods that are used of ``twin_search.TwinSwims``."""

    coordinates: Coordinates

    def rows(self, points: Array) -> Array:
        """Weighted errors at points (E, F), shape (E, n)."""

    def loss_and_step(
        self, members: Members, x: Array, rows: Array, near: Slope
    ) -> tuple[float, Array]:
        """Loss at a point, and the step to its minimum by the linear model."""

    def linear(self, members: Members, fit: Fit) -> Fit:
        """The fit after that step, by the linear model."""


def with_other_sizes(
    problem: Problem, initial: Sequence[tuple[Members, Fit]]
) -> list[tuple[Members, Fit]]:
    """Starts with another size of an effect of one parameter, where that predicts less loss."""
    trials, starts = [], []
    for k, (members, fit) in enumerate(initial):
        for effect in members:
            columns = problem.coordinates.of_effect(effect)
            if len(columns) == 1 and fit.x[columns[0]] == 0.0:
                column = problem.coordinates.columns[columns[0]]
                for size in _JUMPS:
                    x = fit.x.copy()
                    x[columns[0]] = np.clip(size * column.step, column.low, column.high)
                    trials.append(x)
                    starts.append(k)
    if not trials:
        return list(initial)
    rows = problem.rows(np.array(trials))
    out = list(initial)
    best = [problem.linear(m, f).loss for m, f in initial]
    for x, row, k in zip(trials, rows, starts, strict=True):
        members, fit = initial[k]
        loss, _ = problem.loss_and_step(members, x, row, fit.near)
        start = Fit(x, row, loss, fit.near)
        predicted = problem.linear(members, start).loss
        if predicted < best[k] and loss < out[k][1].loss:
            best[k], out[k] = predicted, (members, start)
    return out
