"""Fits of the linear servo, alone and with effects of the catalogue."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.effect import Effect
from sim2real.errors import InputError
from sim2real.identification.first_guess import first_guess
from sim2real.identification.priors import (
    gains,
    inertia_left_out,
    nominal_rotor,
    of_effects,
    plain_parameters,
    scale_inertia,
)
from sim2real.identification.problem import Fit, ServoProblem
from sim2real.identification.search import fit, point_fit
from sim2real.inference.least_squares import OUTLIER_SD, robust_loss
from sim2real.inference.parameters import kronecker
from sim2real.robot import Servo
from sim2real.servo.linearised import fastest_visible_rad_s, ringing_rad_s
from sim2real.servo.parameters import BASE, COLUMNS, INERTIA_LEFT_OUT
from sim2real.servo.trace import Trace

STRENGTHS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the typical value from which each parameter of an effect starts."""


def fit_plain(
    fitted: Sequence[Trace],
    noise: float,
    rng: np.random.Generator,
    servo: Servo | None = None,
    effort: float = 1.0,
) -> tuple[Fit, list[str]]:
    """The best fit of gains and latency, and parameters without visible influence.

    These change simulated angles by less than the noise and are not fitted.

    Args:
        fitted: The joint's recordings.
        noise: Standard deviation of its sensor noise in rad.
        rng: Generator for the scan.
        servo: Its data sheet, from which the rotor of an arm's joint starts.
        effort: Multiple of the largest number of evaluations.

    Raises:
        InputError: If no parameter changes the angles visibly.
    """
    rotor = _assumed_rotor(fitted, servo)
    start, others = first_guess(fitted, rng, rotor_kgm2=rotor)
    whole = ServoProblem(fitted, start, plain_parameters(fitted, start))
    effect = np.linalg.norm(point_fit(whole, start).slopes * whole.natural, axis=0)
    names = [name for name, size in zip(whole.names, effect, strict=True) if size > noise]
    if not names:
        found = f"no motion above the noise of {1e3 * noise:.2g} mrad"
        raise InputError(fitted[0].file, "", found, "a joint that moves visibly")
    starts = np.vstack([start[None], others])
    best = best_of(fitted, starts, names, effort)
    visible = fastest_visible_rad_s(fitted)
    if ringing_rad_s(fitted, best.row) > visible:  # may be an alias of a slower servo
        start, others = first_guess(fitted, rng, rotor_kgm2=rotor, fastest_rad_s=visible)
        best = best_of(fitted, np.vstack([starts, start[None], others]), names, effort)
    return best, [name for name in whole.names if name not in names]


def best_of(
    fitted: Sequence[Trace],
    starts: Array,
    names: Sequence[str] = BASE[:3],
    effort: float = 1.0,
) -> Fit:
    """The best fit of gains and latency from some servos (S, P).

    Args:
        fitted: The joint's recordings.
        starts: The servos.
        names: Those of ``plain_parameters`` to fit.
        effort: Multiple of the largest number of evaluations.
    """
    free = tuple(p for p in plain_parameters(fitted, starts[0]) if p.name in names)
    first, later, last = (round(effort * n) for n in (40, 20, 60))
    return fit(ServoProblem(fitted, starts[0], free), starts, first=first, later=later, last=last)


def with_inertia(best: Fit) -> Fit:
    """Fit again with free inertia, from the given fit and from one with more inertia."""
    heavier = best.row.copy()
    heavier[:3] *= 1.3, 1.3, 0.3
    heavier[INERTIA_LEFT_OUT] = 0.3 * best.inertia
    free = (*gains(best.inertia), inertia_left_out(best.row, best.inertia))
    problem = ServoProblem(best.problem.traces, best.row, free)
    return fit(problem, np.array([best.row, heavier]), first=40)


def refitted(traces: Sequence[Trace], row: Array, effects: Sequence[Effect] = ()) -> Fit:
    """Fit gains, latency and effects, starting from a similar servo (P,)."""
    inertia = scale_inertia(traces, row)
    free = (*gains(inertia), *of_effects(effects, row, inertia))
    return fit(ServoProblem(traces, row, free), row[None])


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

    def fitted(row: Array, rounds: int, evaluations: int) -> Fit:
        own = plain_parameters(traces, row)
        free = (*own, *of_effects(effects, row, plain.inertia, _known(traces)))
        problem = ServoProblem(traces, row, free)
        return fit(problem, row[None], rounds=rounds, first=evaluations, last=rounds * evaluations)

    def loss(candidate: Fit) -> float:
        return candidate.loss(plain.scale_rad)

    starts = _starts(traces, plain, effects, rng)
    short = sorted((fitted(row, 1, 12) for row in starts), key=loss)
    longer = [fitted(start.row, 1, 40) for start in short[:finalists]]
    return fitted(min(longer, key=loss).row, 4, 40)


def _assumed_rotor(fitted: Sequence[Trace], servo: Servo | None) -> float:
    """Rotor inertia in kg m2 from which the fit of an arm's servo starts, and 0 of others."""
    if fitted[0].varying is None:
        return 0.0
    return fitted[0].load.inertia_kgm2 if servo is None else nominal_rotor(servo)


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
    scanned = ServoProblem(traces, plain.row, (*plain.parameters, *added))
    residuals = scanned.row_residuals(rows)
    losses = robust_loss(residuals / plain.scale_rad, OUTLIER_SD)
    places = np.log(0.1 + np.abs(rows[:, columns]) / sizes)
    chosen: list[int] = []
    for k in np.argsort(losses):
        distance = np.abs(places[chosen] - places[k]).max(axis=1)
        if len(chosen) < most and (distance > apart).all():
            chosen.append(int(k))
    return np.asarray(rows[chosen])
