"""Choice of the law of a motor: the limit of its torque, losses, and a sampled controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.control_loop import fit_sampled_loop
from sim2real.identification.priors import MotorPrior, motor_prior
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.identification.search import continued, fit, shortlist
from sim2real.identification.servo_problem import FLAT_COLUMNS, LINE_COLUMNS
from sim2real.inference.correlated_noise import whiteness
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import Parameter
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    CURRENT_LIMIT,
    INERTIA_LEFT_OUT,
    LINE,
    LOOP,
    LOSSES,
    ROTOR,
    SOFT,
)
from sim2real.servo.trace import Trace, shows_inertia

EXPLAINED = 1.15
"""Ratio of residual to noise below which no more parameters are added."""
_SOFT_STARTS_S = ((1e-3, 3e-4), (0.01, 1e-3), (0.01, 5e-3))
"""Stick and creep times from which fits of gradual friction start: nearly 0, MuJoCo's, larger."""


def choose_motor(
    fitted: Sequence[Trace],
    plain: Fit,
    servo: Servo,
    noise: float,
    rng: np.random.Generator,
    *,
    losses: bool = True,
    before: Fit | None = None,
    white: float = 0.1,
    error_before_loop: float = 15.0,
    error_with_loop: float = 1.5,
    loop_parameters: int = 12,
) -> Fit:
    """Fit the limit of the motor's torque and, if that does not explain the recordings, its losses.

    Where the linear servo explains them, its gains are kept and only the limit is fitted. Losses
    are included if they decrease the loss by clearly more than twice their number (Akaike's
    criterion). The same applies to gradual friction and, where the residual is at most
    ``error_before_loop`` times the noise, to a sampled loop, which leaves at most
    ``error_with_loop`` times the noise and counts as ``loop_parameters``, the best of a thousand
    periods and phases.

    Parts of a fit to fewer recordings, ``before``, are kept, and a limit, rotor and losses are
    added that further recordings show. ``noise`` is the standard deviation of
    the sensor's noise in rad. Without ``losses``, as where effects are fitted instead, the motor's
    line and rotor are fitted. A residual whose lag-1 autocorrelation is below ``white`` counts as
    white.
    """
    if before is not None and LOOP[0] in before.names:
        return continued(before, fitted)
    prior = motor_prior(servo, fitted)
    linear = fitted[0].varying is None  # on an arm the motor's rotor is needed
    if linear and rms([plain.error]) < EXPLAINED * noise:
        return fit_limit(fitted, plain, prior, LINE, rng, noise=noise)
    if not losses:
        return fit_motor(fitted, plain, prior, (*BASE[:3], *LINE, ROTOR), rng)
    if before is not None and BASE[0] not in before.names:
        before = None
    chosen = _fit_continuous(fitted, plain, prior, noise, rng, before)
    if before is not None:
        return chosen
    ratio = rms([chosen.error]) / noise
    explained = ratio < EXPLAINED and whiteness(chosen.residuals) < white
    looped = None if explained or ratio > error_before_loop else fit_sampled_loop(chosen, prior)
    if looped is not None and rms([looped.error]) <= error_with_loop * noise:
        return _better(chosen, looped, loop_parameters)
    return chosen


def _fit_continuous(
    fitted: Sequence[Trace],
    plain: Fit,
    prior: MotorPrior,
    noise: float,
    rng: np.random.Generator,
    before: Fit | None = None,
    *,
    least_gain: float = 2.0,
) -> Fit:
    """Fit a motor with a continuous controller, without losses that cannot be chosen."""
    names: tuple[str, ...] = (*BASE[:3], *LINE)
    if shows_inertia(fitted):
        names = (*names, ROTOR)
    if before is None:
        first = fit_limit(fitted, plain, prior, names, rng, noise=noise)
    else:
        names, starts = (*names, *before.names), before.minima
        if before.law == "current_limited":
            prior = prior.flat(float(plain.row[1]))
        if not set(LOSSES).isdisjoint(names):
            drawn = _candidates(prior.of(names), plain, rng, 512, before.row)
            problem = replace(before.problem, traces=fitted, parameters=prior.of(names))
            starts = np.vstack([starts, shortlist(problem, drawn, 6)])
        first = fit_motor(fitted, plain, prior, names, rng, starts)
    if rms([first.error]) < EXPLAINED * noise:
        return first
    if before is None and first.law == "current_limited":
        prior = prior.flat(float(plain.row[1]))
    names, full = (*first.names, *LOSSES), first
    if set(LOSSES).isdisjoint(first.names):
        starts = _candidates(prior.of(names), plain, rng, 512, first.row)
        problem = ServoProblem(fitted, plain_row(0.0, 0.0, 0.0), prior.of(names), prior.ties)
        starts = shortlist(problem, starts, 12)
        full = fit(
            problem, starts, first=40, later=25, behind=200.0, least_gain=least_gain, rng=rng
        )
        if _gain(first, full) < 2 * least_gain:
            return _better(first, full)  # and so without friction that could be gradual
    chosen = _better(first, full)
    if rms([chosen.error]) < EXPLAINED * noise or before is not None:
        return chosen
    starts = np.tile(full.row, (len(_SOFT_STARTS_S), 1))
    starts[:, [COLUMNS.index(name) for name in SOFT]] = _SOFT_STARTS_S
    return _better(chosen, fit_motor(fitted, plain, prior, (*names, *SOFT), rng, starts))


def fit_limit(
    traces: Sequence[Trace],
    plain: Fit,
    prior: MotorPrior,
    names: Sequence[str],
    rng: np.random.Generator,
    *,
    noise: float,
    plausible_sd: float = 2.0,
    current_limits: Sequence[float] = (0.85, 0.6),
) -> Fit:
    """Fit a motor with the likeliest limit of its torque.

    A drive limited in voltage has the torque-speed line of its data sheet. One limited in current
    has a flat limit, whatever the speed, and its damping acts in addition: the same law, in which
    the no-load speed follows from the damping instead of the data sheet (``MotorPrior.flat``). Both
    at once are a line and a current limit below its stall torque. The flat limit is tried where the
    no-load speed is ``plausible_sd`` standard deviations of its prior beyond the data sheet, both
    where one limit leaves a residual, from ``current_limits`` as shares of the stall torque; the
    larger evidence decides. A limit of which only the prior tells is none.

    ``names`` are the columns to fit, those of the line among them; the gains are those of the
    linear servo if they are not. ``noise`` is the sensor's standard deviation in rad.
    """
    line = fit_motor(traces, plain, prior, names, rng)
    if prior.ties.drive is not None or traces[0].load is PER_INERTIA:
        return line  # the drive is known, or the unit of torque is not
    options, speed = [line], prior[LINE[1]]
    plausible = min(speed.nominal + plausible_sd * speed.prior_sd, np.log(speed.high) - 1e-3)
    if np.log(line.row[LINE_COLUMNS[1]]) > plausible:
        flat = prior.flat(float(plain.row[1]))
        start = line.row.copy()
        start[LINE_COLUMNS[1]] = np.exp(flat[LINE[1]].nominal)
        options.append(fit_motor(traces, plain, flat, names, rng, start[None]))
    best = _likeliest(options)
    if BASE[0] in names and current_limits and rms([best.error]) > EXPLAINED * noise:
        starts = np.tile(line.row, (len(current_limits), 1))
        starts[:, LINE_COLUMNS] = [np.exp(prior[name].nominal) for name in LINE]
        stall = np.exp(prior[LINE[0]].nominal)
        starts[:, COLUMNS.index(CURRENT_LIMIT)] = stall * np.array(current_limits)
        both = fit_motor(traces, plain, prior, (*names, CURRENT_LIMIT), rng, starts)
        if both.told(CURRENT_LIMIT):
            best = _likeliest([best, both])
    return best


def fit_motor(
    traces: Sequence[Trace],
    plain: Fit,
    prior: MotorPrior,
    names: Sequence[str],
    rng: np.random.Generator,
    starts: Array | None = None,
    *,
    candidates: int = 64,
    searches: int = 4,
) -> Fit:
    """Fit the columns ``names`` of a motor; gains that are not among them are those of ``plain``.

    Searches start from the servos ``starts`` (S, P), by default from the best ``searches`` of
    ``candidates`` drawn from the prior.
    """
    row = plain_row(0.0, 0.0, 0.0)
    if BASE[0] not in names:
        row[:3] = plain.row[:3]
    problem = ServoProblem(traces, row, prior.of(names), prior.ties)
    if starts is None:
        starts = _candidates(problem.parameters, plain, rng, candidates)
        # where the linear servo fits, one search, from its values
        starts = shortlist(problem, starts, searches if BASE[0] in names else 1)
    return fit(problem, starts, rng=None if set(LOSSES).isdisjoint(names) else rng)


def _candidates(
    parameters: Sequence[Parameter],
    plain: Fit,
    rng: np.random.Generator,
    count: int,
    first: Array | None = None,
) -> Array:
    """Servos (count, P) drawn from the prior, half with linear gains; the first is ``first``."""
    rows = np.tile(plain_row(0.0, 0.0, 0.0), (count, 1))
    half = count // 2
    by_name = {p.name: p for p in parameters}
    for p in parameters:
        width = p.prior_sd if np.isfinite(p.prior_sd) else 0.0
        drawn = p.nominal + width * rng.standard_normal(count)
        drawn = np.exp(drawn) if p.log else drawn if p.nominal else 0.5 * np.abs(drawn)
        rows[:, COLUMNS.index(p.name)] = drawn
    kp, kd = np.maximum(plain.row[:2], 1e-9)
    latency, rotor = float(plain.row[2]), float(plain.row[INERTIA_LEFT_OUT])
    back_emf = np.exp(by_name[LINE[0]].nominal - by_name[LINE[1]].nominal)
    rows[:, 0] = kp * np.exp(rng.uniform(0.0, 1.2, count))
    rows[:, 1] = back_emf * np.exp(0.3 * rng.standard_normal(count))
    rows[:, 2] = rng.uniform(0.0, max(latency, 0.01), count)
    rows[:half, :3] = kp, kd, latency
    if rotor > 0 and ROTOR in by_name:
        rows[:half, COLUMNS.index(ROTOR)] = rotor
    rows[0, LINE_COLUMNS] *= np.exp(2.0)
    if first is not None:
        rows[0] = first
    return rows


def _likeliest(options: Sequence[Fit]) -> Fit:
    """The fit with the largest evidence, for residuals like those of the best fit."""
    best = min(options, key=lambda motor: motor.scale_rad**2 * motor.inflation)
    return max(options, key=lambda motor: motor.evidence(best.scale_rad, best.inflation))


def _better(fewer: Fit, more: Fit, added: int | None = None, *, beyond_chance: float = 6.0) -> Fit:
    """The fit with more parameters if they decrease the loss significantly, else the other."""
    if added is None:
        added = len(more.names) - len(fewer.names)
    return more if _gain(fewer, more) > 2 * added + beyond_chance else fewer


def _gain(fewer: Fit, more: Fit) -> float:
    """Decrease of the loss by more parameters, for residuals like theirs."""
    noise = more.scale_rad, more.inflation
    return fewer.loss(*noise) - more.loss(*noise)


def without_flat_limit(row: Array) -> Array:
    """A servo's parameters (P,), a flat limit of its effects as the limit of its motor's law."""
    limit, share = (float(x) for x in row[FLAT_COLUMNS])
    moved = row.copy()
    moved[FLAT_COLUMNS] = 0.0
    damping = max(share, 1e-2) * max(float(row[1]), 1e-9)
    moved[LINE_COLUMNS] = limit, limit / damping
    return moved
