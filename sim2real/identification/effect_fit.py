"""Fit effects of the catalogue together with the gains, which would otherwise absorb them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import Effect
from sim2real.identification.fit import Fit, errors, fit, gains, of_effects
from sim2real.inference.least_squares import OUTLIER_SD, robust_loss
from sim2real.inference.low_discrepancy import kronecker
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace

STRENGTHS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the typical value from which each parameter of an effect starts."""


@dataclass(frozen=True)
class EffectScan:
    """Settings of the scan for starting points.

    Attributes:
        grid: Largest number of points with the gains of the plain fit.
        points: Number of points with other gains.
        frequency_rad_s: Range of the servo's natural frequency there.
        damping_ratio: Range of its damping ratio.
        latency: Range of its latency, relative to that of the plain fit.
        apart: Smallest distance between starting points, as the logarithm of a ratio.
        descents: Number of starting points.
        finalists: Number of short fits that are continued.
    """

    grid: int = 256
    points: int = 768
    frequency_rad_s: tuple[float, float] = (10.0, 60.0)
    damping_ratio: tuple[float, float] = (0.25, 1.5)
    latency: tuple[float, float] = (0.85, 1.05)
    apart: float = 0.5
    descents: int = 12
    finalists: int = 3


EFFECT_SCAN = EffectScan()


def fit_effects(
    traces: Sequence[Trace],
    plain: Fit,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    scan: EffectScan = EFFECT_SCAN,
) -> Fit:
    """Fit gains, latency and the parameters of effects to all traces at once.

    The loss has several minima where effects act on contact or at a limit, and the plain fit
    absorbs part of them. So fits start from the best points of a scan over all parameters.

    Args:
        traces: The joint's recordings.
        plain: The fit of the plain servo.
        effects: The effects to add.
        rng: Generator for the scan.
        scan: Settings of the scan.
    """

    def fitted(row: Array, *, rounds: int, evaluations: int) -> Fit:
        free = (*gains(row, plain.inertia), *of_effects(effects, row, plain.inertia))
        return fit(traces, row, free, rounds=rounds, evaluations=evaluations)

    def loss(candidate: Fit) -> float:
        return candidate.loss(plain.scale_rad)

    short = [
        fitted(row, rounds=0, evaluations=12) for row in _starts(traces, plain, effects, rng, scan)
    ]
    longer = [
        fitted(candidate.row, rounds=0, evaluations=40)
        for candidate in sorted(short, key=loss)[: scan.finalists]
    ]
    return fitted(min(longer, key=loss).row, rounds=3, evaluations=40)


def _starts(
    traces: Sequence[Trace],
    plain: Fit,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    scan: EffectScan,
) -> Array:
    """Rows (N, P) with the smallest losses of a grid and a scan, each apart from the others.

    Every fourth value of a parameter in the scan is the smallest one.
    """
    added = of_effects(effects, plain.row, plain.inertia)
    columns = [COLUMNS.index(p.name) for p in added]
    choices = [[min(max(s * p.nominal, p.low), p.high) for s in STRENGTHS] for p in added]
    full_grid = len(STRENGTHS) ** len(choices) <= scan.grid
    grid = list(itertools.product(*choices)) if full_grid else list(zip(*choices, strict=True))
    rows = np.tile(plain.row, (len(grid) + scan.points, 1))
    rows[: len(grid), columns] = grid
    sizes = np.tile([p.nominal for p in added], (len(rows), 1))
    points = kronecker(scan.points, len(added) + 3, rng)
    for row, size, point in zip(rows[len(grid) :], sizes[len(grid) :], points, strict=True):
        frequency, ratio = (
            low * (high / low) ** share
            for (low, high), share in zip(
                (scan.frequency_rad_s, scan.damping_ratio), point, strict=False
            )
        )
        row[0] = plain.inertia * frequency**2
        row[1] = 2 * ratio * plain.inertia * frequency
        row[2] *= scan.latency[0] + (scan.latency[1] - scan.latency[0]) * point[2]
        own = of_effects(effects, row, plain.inertia)
        for k, (p, share) in enumerate(zip(own, point[3:], strict=True)):
            strength = STRENGTHS[0] * (STRENGTHS[-1] / STRENGTHS[0]) ** (share * 4 / 3)
            row[columns[k]] = (
                p.low if share > 0.75 else np.clip(strength * p.nominal, p.low, p.high)
            )
            size[k] = p.nominal
    residuals = np.concatenate(errors(Simulator(traces), rows), axis=1)
    losses = [robust_loss(error, OUTLIER_SD * plain.scale_rad) for error in residuals]
    places = np.log(0.1 + np.abs(rows[:, columns]) / sizes)
    chosen: list[int] = []
    for k in np.argsort(losses):
        if len(chosen) < scan.descents and all(
            np.abs(places[k] - places[other]).max() > scan.apart for other in chosen
        ):
            chosen.append(int(k))
    return np.asarray(rows[chosen])
