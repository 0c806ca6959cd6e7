"""Fit effects of the catalogue together with the gains, which would otherwise absorb them."""

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

    Every parameter of an effect starts from several values, as the gradient may vanish at 0.

    Args:
        traces: The joint's recordings.
        plain: The fit of the plain servo.
        effects: The effects to add.
    """
    added = of_effects(effects, plain.row, plain.inertia)
    free = (*gains(plain.row, plain.inertia), *added)
    fits = [
        fit(traces, row, free, rounds=0, evaluations=12)
        for row in _starts(traces, plain, effects, added)
    ]
    best = min(fits, key=lambda candidate: candidate.loss(plain.scale_rad))
    return fit(traces, best.row, free, rounds=3, evaluations=40)


def _starts(
    traces: Sequence[Trace],
    plain: Fit,
    effects: Sequence[Effect],
    added: Sequence[Parameter],
    *,
    most_starts: int = 256,
) -> Array:
    """For each starting value of each parameter, the best combination with the others."""
    choices = [[min(max(s * p.nominal, p.low), p.high) for s in STRENGTHS] for p in added]
    full_grid = len(STRENGTHS) ** len(choices) <= most_starts
    grid = np.array(
        list(itertools.product(*choices)) if full_grid else list(zip(*choices, strict=True))
    )
    rows = np.tile(plain.row, (len(grid), 1))
    rows[:, [COLUMNS.index(p.name) for p in added]] = grid
    residuals = np.concatenate(errors(Simulator(traces), rows), axis=1)
    order = np.argsort([robust_loss(error, OUTLIER_SD * plain.scale_rad) for error in residuals])
    best = {
        int(next(k for k in order if grid[k, column] == value))
        for column in range(grid.shape[1])
        for value in np.unique(grid[:, column])
    }
    return np.asarray(rows[sorted(best)])
