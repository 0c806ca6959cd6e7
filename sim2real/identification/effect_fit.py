"""Fit effects of the catalogue together with the gains that would otherwise hide them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import Effect
from sim2real.identification.fit import Fit, errors, fit, gains, of_effects
from sim2real.inference.least_squares import OUTLIER_SD, robust_loss
from sim2real.inference.parameters import Parameter
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

STRENGTHS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the typical value from which each parameter of an effect starts."""


def fit_effects(traces: Sequence[Trace], plain: Fit, effects: Sequence[Effect]) -> Fit:
    """Fit gains, latency and the parameters of effects to all traces at once.

    Every parameter of an effect starts from several strengths, so that none is lost at zero.

    Args:
        traces: The joint's recordings.
        plain: The fit of the plain servo.
        effects: What to add to it.
    """
    added = of_effects(effects, plain.row, plain.inertia)
    free = (*gains(plain.row, plain.inertia), *added)
    tried = [
        fit(traces, row, free, rounds=0, evaluations=12)
        for row in _starts(traces, plain, effects, added)
    ]
    nearest = min(tried, key=lambda one: one.loss(plain.scale_rad))
    return fit(traces, nearest.row, free, rounds=3, evaluations=40)


def _starts(
    traces: Sequence[Trace],
    plain: Fit,
    effects: Sequence[Effect],
    added: Sequence[Parameter],
    *,
    most_starts: int = 256,
) -> Array:
    """For each strength of each parameter the combination that fits best, gains as fitted."""
    choices = [[min(max(s * p.nominal, p.low), p.high) for s in STRENGTHS] for p in added]
    every = len(STRENGTHS) ** len(choices) <= most_starts
    grid = np.array(
        list(itertools.product(*choices)) if every else list(zip(*choices, strict=True))
    )
    rows = np.tile(plain.row, (len(grid), 1))
    rows[:, [COLUMNS.index(p.name) for p in added]] = grid
    left = np.concatenate(errors(Simulator(traces), rows), axis=1)
    order = np.argsort([robust_loss(error, OUTLIER_SD * plain.scale_rad) for error in left])
    best = {
        int(next(k for k in order if grid[k, column] == value))
        for column in range(grid.shape[1])
        for value in np.unique(grid[:, column])
    }
    return np.asarray(rows[sorted(best)])
