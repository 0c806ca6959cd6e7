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
from sim2real.inference.parameters import Parameter, column, kronecker
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

    These change simulated angles by less than the ``noise``, the sensor's standard deviation in
    rad, and are not fitted. The rotor of an arm's joint starts from the data sheet.

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
    """The best fit of gains and latency (``names`` of ``plain_parameters``) from servos (S, P)."""
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
    traces: Sequence[Trace], plain: Fit, effects: Sequence[Effect], rng: np.random.Generator
) -> Fit:
    """Fit gains, latency and the parameters of effects to all traces at once.

    The loss has several minima where effects act on contact or at a limit, and the plain fit
    absorbs part of them. So fits start from the best points of a scan over all parameters.
    """
    # on an arm the load is what the rotor is not
    known = () if traces[0].varying is None else ("rotor_inertia_kgm2",)
    added = of_effects(effects, plain.row, plain.inertia, known)
    own = plain_parameters(traces, plain.row)
    problem = ServoProblem(traces, plain.row, (*own, *added))
    starts = _starts(problem, plain, added, rng)
    return fit(problem, starts, first=40, later=40, last=160, behind=300.0)


def _assumed_rotor(fitted: Sequence[Trace], servo: Servo | None) -> float:
    """Rotor inertia in kg m2 from which the fit of an arm's servo starts, and 0 of others."""
    if fitted[0].varying is None:
        return 0.0
    return fitted[0].load.inertia_kgm2 if servo is None else nominal_rotor(servo)


def _starts(
    problem: ServoProblem,
    plain: Fit,
    added: Sequence[Parameter],
    rng: np.random.Generator,
    *,
    grid_points: int = 256,
    scan_points: int = 768,
    low: tuple[float, float, float] = (10.0, 0.25, 0.85),
    high: tuple[float, float, float] = (60.0, 1.5, 1.05),
    apart: float = 0.5,
    most: int = 12,
) -> Array:
    """Servos (N, P) with the smallest losses of a grid and a scan, each apart from the others."""
    columns, typical = [COLUMNS.index(p.name) for p in added], column(added, "nominal")
    full_grid = len(STRENGTHS) ** len(added) <= grid_points
    alike = [(strength,) * len(added) for strength in STRENGTHS]
    grid = list(itertools.product(STRENGTHS, repeat=len(added))) if full_grid else alike
    points = kronecker(scan_points, 3 + len(added), rng)
    frequency, ratio, latency = (np.array(low) * (np.divide(high, low) ** points[:, :3])).T
    share, span = points[:, 3:], STRENGTHS[-1] / STRENGTHS[0]
    scan = np.where(share > 0.75, 0.0, STRENGTHS[0] * span ** (share * 4 / 3))  # 0: absent
    strengths = np.vstack([grid, scan])
    rows = np.tile(plain.row, (len(strengths), 1))
    gains = plain.inertia * np.stack([frequency**2, 2 * ratio * frequency], axis=1)
    rows[len(grid) :, :3] = np.column_stack([gains, latency * plain.row[2]])
    values = np.clip(strengths * typical, column(added, "low"), column(added, "high"))
    rows[:, columns] = np.where(strengths > 0, values, np.maximum(column(added, "low"), 0.0))
    losses = robust_loss(problem.row_residuals(rows) / plain.scale_rad, OUTLIER_SD)
    places = np.log(0.1 + np.abs(rows[:, columns]) / typical)
    chosen: list[int] = []
    for k in np.argsort(losses):
        distance = np.abs(places[chosen] - places[k]).max(axis=1)
        if len(chosen) < most and (distance > apart).all():
            chosen.append(int(k))
    return np.asarray(rows[chosen])
