"""Fit effects of the catalogue together with the gains, which would otherwise absorb them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import Effect
from sim2real.identification.fit import Fit, errors, fit, of_effects, plain_parameters
from sim2real.inference.least_squares import OUTLIER_SD, robust_loss
from sim2real.inference.low_discrepancy import kronecker
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

STRENGTHS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the typical value from which each parameter of an effect starts."""


def fit_effects(
    traces: Sequence[Trace],
    plain: Fit,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    finalists: int = 3,
) -> Fit:
    """Fit gains, latency and the parameters of effects to all traces at once.

    The loss has several minima where effects act on contact or at a limit, and the plain fit
    absorbs part of them. So fits start from the best points of a scan over all parameters.

    Args:
        traces: The joint's recordings.
        plain: The fit of the plain servo.
        effects: The effects to add.
        rng: Generator for the scan.
        finalists: Number of short fits that are continued.
    """

    def fitted(row: Array, *, rounds: int, evaluations: int) -> Fit:
        own = plain_parameters(traces, row)
        free = (*own, *of_effects(effects, row, plain.inertia, _known(traces)))
        return fit(traces, row, free, rounds=rounds, evaluations=evaluations)

    def loss(candidate: Fit) -> float:
        return candidate.loss(plain.scale_rad)

    starts = _starts(traces, plain, effects, rng)
    short = sorted((fitted(row, rounds=0, evaluations=12) for row in starts), key=loss)
    longer = [fitted(start.row, rounds=0, evaluations=40) for start in short[:finalists]]
    return fitted(min(longer, key=loss).row, rounds=3, evaluations=40)


def _known(traces: Sequence[Trace]) -> tuple[str, ...]:
    """Parameters of effects that are not fitted: on an arm the load is what the rotor is not."""
    return () if traces[0].varying is None else ("rotor_inertia_kgm2",)


def _starts(
    traces: Sequence[Trace],
    plain: Fit,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    grid_points: int = 256,
    scan_points: int = 768,
    frequency_rad_s: tuple[float, float] = (10.0, 60.0),
    damping_ratio: tuple[float, float] = (0.25, 1.5),
    latency: tuple[float, float] = (0.85, 1.05),
    apart: float = 0.5,
    most: int = 12,
) -> Array:
    """Rows (N, P) with the smallest losses of a grid and a scan, each apart from the others.

    Every fourth value of a parameter in the scan is that without the effect.
    """
    added = of_effects(effects, plain.row, plain.inertia, _known(traces))
    columns = [COLUMNS.index(p.name) for p in added]
    choices = [[min(max(s * p.nominal, p.low), p.high) for s in STRENGTHS] for p in added]
    full_grid = len(STRENGTHS) ** len(choices) <= grid_points
    grid = list(itertools.product(*choices)) if full_grid else list(zip(*choices, strict=True))
    rows = np.tile(plain.row, (len(grid) + scan_points, 1))
    rows[: len(grid), columns] = grid
    sizes = np.tile([p.nominal for p in added], (len(rows), 1))
    points = kronecker(scan_points, len(added) + 3, rng)
    for row, size, point in zip(rows[len(grid) :], sizes[len(grid) :], points, strict=True):
        frequency, ratio = (
            low * (high / low) ** share
            for (low, high), share in zip((frequency_rad_s, damping_ratio), point, strict=False)
        )
        row[0] = plain.inertia * frequency**2
        row[1] = 2 * ratio * plain.inertia * frequency
        row[2] *= latency[0] + (latency[1] - latency[0]) * point[2]
        own = of_effects(effects, row, plain.inertia, _known(traces))
        for k, (p, share) in enumerate(zip(own, point[3:], strict=True)):
            strength = STRENGTHS[0] * (STRENGTHS[-1] / STRENGTHS[0]) ** (share * 4 / 3)
            value = np.clip(strength * p.nominal, p.low, p.high)
            absent = max(p.low, 0.0)
            row[columns[k]], size[k] = absent if share > 0.75 else value, p.nominal
    residuals = np.concatenate(errors(Simulator(traces), rows), axis=1)
    losses = [robust_loss(error, OUTLIER_SD * plain.scale_rad) for error in residuals]
    places = np.log(0.1 + np.abs(rows[:, columns]) / sizes)
    chosen: list[int] = []
    for k in np.argsort(losses):
        distance = np.abs(places[chosen] - places[k]).max(axis=1)
        if len(chosen) < most and (distance > apart).all():
            chosen.append(int(k))
    return np.asarray(rows[chosen])
