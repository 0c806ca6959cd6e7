"""Fits of one joint: the linear servo, the parts of a motor's law that the data show, effects."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from sim2real.arrays import Array
from sim2real.effects.effect import Effect
from sim2real.errors import InputError
from sim2real.identification.control_loop import fit_sampled_loop
from sim2real.identification.priors import (
    MotorPrior,
    gains,
    motor_prior,
    nominal_rotor,
    of_effects,
    plain_parameters,
    scale_inertia,
)
from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.identification.search import drawn, first_guess, fit
from sim2real.inference.correlated_noise import whiteness
from sim2real.inference.least_squares import rms
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.linearised import fastest_visible_rad_s, ringing_rad_s
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    CONTROL_SIDE,
    CURRENT_LIMIT,
    INERTIA_LEFT_OUT,
    LINE,
    LINE_COLUMNS,
    LOOP,
    LOSSES,
    RATE_LIMIT,
    ROTOR,
    SOFT,
    TRAINS,
)
from sim2real.servo.trace import Trace, fit_noise, shows_inertia

EXPLAINED = 1.15
"""Ratio of residual to noise below which no more parameters are added."""


def fit_plain(
    traces: Sequence[Trace],
    rng: np.random.Generator,
    servo: Servo | None = None,
    effort: float = 1.0,
) -> tuple[Fit, list[str]]:
    """The best fit of gains and latency, and parameters without visible influence.

    These change simulated angles by less than the noise of the sensor, and are not fitted. The
    rotor of an arm's joint starts from the data sheet.

    Raises:
        InputError: If no parameter changes the angles visibly.
    """
    noise, rotor = fit_noise(traces), 0.0
    if traces[0].varying is not None:
        rotor = traces[0].load.inertia_kgm2 if servo is None else nominal_rotor(servo)
    starts = first_guess(traces, rng, rotor_kgm2=rotor)
    problem = ServoProblem(traces, starts[0], plain_parameters(traces, starts[0]))
    _, (slopes,) = problem.slopes(problem.searched(starts[:1]), rough=False)
    seen = np.linalg.norm(slopes * problem.natural, axis=0) > noise
    if not seen.any():
        found = f"no motion above the noise of {1e3 * noise:.2g} mrad"
        raise InputError(traces[0].file, "", found, "a joint that moves visibly")
    without_influence = list(compress(problem.names, ~seen))
    problem = replace(problem, parameters=tuple(compress(problem.parameters, seen)))
    best = fit(problem, starts, effort=effort)
    visible = fastest_visible_rad_s(traces)
    if ringing_rad_s(traces, best.row) > visible:  # may be an alias of a slower servo
        slower = first_guess(traces, rng, rotor_kgm2=rotor, fastest_rad_s=visible)
        best = fit(problem, np.vstack([starts, slower]), effort=effort)
    return best, without_influence


def refitted(traces: Sequence[Trace], row: Array, effects: Sequence[Effect] = ()) -> Fit:
    """Fit gains, latency and effects, from a similar servo (P,) and one with more inertia."""
    inertia = scale_inertia(traces, row)
    free = (*gains(inertia), *of_effects(effects, row, inertia))
    starts = row[None]
    if any(effect.name == "unmodelled_inertia" for effect in effects):
        heavier = row.copy()
        heavier[:3] *= 1.3, 1.3, 0.3
        heavier[INERTIA_LEFT_OUT] = 0.3 * inertia
        starts = np.stack([row, heavier])
    return fit(ServoProblem(traces, row, free), starts)


def fit_effects(plain: Fit, effects: Sequence[Effect], rng: np.random.Generator) -> Fit:
    """Fit gains, latency and the parameters of effects to the recordings of a fit without them.

    The loss has several minima where effects act on contact or at a limit, and the plain fit
    absorbs part of them: hence the many starts. The controller of a gear train sees the motor or
    the output, whichever fits better, and its flanks do not rebound.
    """
    traces = plain.problem.traces
    # on an arm the load is what the rotor is not
    load = () if traces[0].varying is None else ("rotor_inertia_kgm2",)
    known = (*load, CONTROL_SIDE, "restitution")
    added = of_effects(effects, plain.row, plain.inertia, known)
    own = plain_parameters(traces, plain.row)
    rows = [plain.row]
    sides = [COLUMNS.index(f"{e.name}.{CONTROL_SIDE}") for e in effects if e.name in TRAINS]
    for side in (0.5, 1.0) if sides else ():
        rows.append(plain.row.copy())
        rows[-1][sides] = side
    fits = []
    for row in rows:
        problem = ServoProblem(traces, row, (*own, *added))
        starts = drawn(problem, plain, rng, draws=1024)
        fits.append(fit(problem, starts, last=160, behind=300.0))
    return min(fits, key=lambda one: rms([one.error]))


def choose_motor(
    plain: Fit,
    servo: Servo,
    rng: np.random.Generator,
    *,
    losses: bool = True,
    set_points: bool = False,
    before: Fit | None = None,
) -> Fit:
    """Fit the limit of the motor's torque and, if that does not explain the recordings, its losses.

    Where the linear servo explains them, its gains are kept and only the limit is fitted.
    Losses are included if they decrease the loss by clearly more than twice their number
    (Akaike's criterion). The same applies to gradual friction and, where the residual is at
    most 15 times the noise, to a sampled loop, which leaves at most 1.5 times the noise and
    counts as twelve parameters, as it is the best of a thousand periods and phases. With
    ``set_points`` a limit of the speed of set-points inside the servo is fitted too, if they
    determine it and the evidence is larger. A sampled loop of ``before``, the fit to fewer
    recordings, is kept, and searches start from that fit where it has the same parameters.

    Without ``losses``, as where effects are fitted instead, the motor's line and rotor are fitted.
    A residual whose lag-1 autocorrelation is below 0.1 counts as white.
    """
    traces = plain.problem.traces
    if before is not None and LOOP[0] in before.names:
        return fit(replace(before.problem, traces=traces), before.minima, rounds=3, first=10)
    noise, prior = fit_noise(traces), motor_prior(servo, traces)
    if traces[0].varying is None and rms([plain.error]) < EXPLAINED * noise:
        return fit_limit(plain, prior, LINE, rng)

    def with_set_point_limit(best: Fit) -> Fit:
        explained = rms([best.error]) < EXPLAINED * noise or RATE_LIMIT in best.names
        if explained or not set_points or before is not None or traces[0].varying is not None:
            return best
        known = prior if best.law == "motor" else prior.flat(float(best.row[1]))
        values = servo.no_load_speed_rad_s * np.array([1.0, 0.7])
        return _limited(best, best.row, known, best.names, RATE_LIMIT, values, rng)

    names: tuple[str, ...] = (*BASE[:3], *LINE)
    if not losses:
        return fit_motor(plain, prior, (*names, ROTOR), rng)
    if shows_inertia(traces):
        names = (*names, ROTOR)
    if before is None or BASE[0] not in before.names:
        best = fit_limit(plain, prior, names, rng)
        # Without it a servo that limits its set-points seems heavier and its motor slower.
        best = with_set_point_limit(best)
    else:
        names = tuple(dict.fromkeys((*names, *before.names)))
        known = prior if before.law == "motor" else prior.flat(float(plain.row[1]))
        best = fit_motor(plain, known, names, rng, before.minima)
    if best.law == "current_limited":
        prior = prior.flat(float(plain.row[1]))
    for part in (LOSSES, SOFT) if before is None else (LOSSES,):
        if rms([best.error]) < EXPLAINED * noise or part[0] in best.names:
            break
        more = fit_motor(best, prior, (*best.names, *part), rng)
        if not _better(best, more, len(part)):
            break
        best = more
    best = with_set_point_limit(best)  # friction hides it, too
    if before is None and CURRENT_LIMIT in best.names:  # fitted first, where others were missing
        fewer = [name for name in best.names if name != CURRENT_LIMIT]
        without = fit_motor(best, prior, fewer, rng, best.minima)
        best = best if _better(without, best, 1) else without
    ratio = rms([best.error]) / noise
    explained = ratio < EXPLAINED and whiteness(best.residuals) < 0.1
    if explained or ratio > 15 or before is not None:
        return best
    looped = fit_sampled_loop(best, prior)
    if looped is None or rms([looped.error]) > 1.5 * noise:
        return best
    return looped if _better(best, looped, 12) else best


def fit_limit(plain: Fit, prior: MotorPrior, names: Sequence[str], rng: np.random.Generator) -> Fit:
    """Fit a motor with the likeliest limit of its torque.

    A drive limited in voltage has the torque-speed line of its data sheet. One limited in
    current has a flat limit, whatever the speed, and its damping acts in addition: the same
    law, in which the no-load speed follows from the damping instead of the data sheet
    (``MotorPrior.flat``). Both at once are a line and a current limit below its stall torque.
    The flat limit is tried where the no-load speed is two standard deviations of its prior
    beyond the data sheet, both where one limit leaves a residual, from 0.85 and 0.6 of the
    stall torque; the larger evidence decides. A limit of which only the prior tells is none.

    ``names`` are the columns to fit, those of the line among them; the gains are those of the
    linear servo if they are not.
    """
    line = fit_motor(plain, prior, names, rng)
    traces = plain.problem.traces
    if prior.ties.drive is not None or traces[0].load is PER_INERTIA:
        return line  # the drive is known, or the unit of torque is not
    options, speed = [line], prior[LINE[1]]
    plausible = min(speed.nominal + 2 * speed.prior_sd, np.log(speed.high) - 1e-3)
    if np.log(line.row[LINE_COLUMNS[1]]) > plausible:
        flat = prior.flat(float(plain.row[1]))
        start = line.row.copy()
        start[LINE_COLUMNS[1]] = np.exp(flat[LINE[1]].nominal)
        options.append(fit_motor(plain, flat, names, rng, start[None]))
    best = _likeliest(options)
    if BASE[0] in names and rms([best.error]) > EXPLAINED * fit_noise(traces):
        row = line.row.copy()
        row[LINE_COLUMNS] = [np.exp(prior[name].nominal) for name in LINE]
        values = row[LINE_COLUMNS[0]] * np.array([0.85, 0.6])
        best = _limited(best, row, prior, names, CURRENT_LIMIT, values, rng)
    return best


def _limited(
    best: Fit,
    row: Array,
    prior: MotorPrior,
    names: Sequence[str],
    limit: str,
    values: Array,
    rng: np.random.Generator,
) -> Fit:
    """A fit, or the likelier one with a limit, from ``row`` (P,), that the recordings determine."""
    starts = np.tile(row, (len(values), 1))
    starts[:, COLUMNS.index(limit)] = values
    more = fit_motor(best, prior, (*names, limit), rng, starts)
    return _likeliest([best, more]) if more.told(limit) else best


def fit_motor(
    base: Fit,
    prior: MotorPrior,
    names: Sequence[str],
    rng: np.random.Generator,
    starts: Array | None = None,
) -> Fit:
    """Fit the columns ``names`` of a motor; gains that are not among them are those of ``base``.

    Searches start from the servos ``starts`` (S, P), by default from draws about ``base``, a fit of
    fewer columns to the same recordings. Those for losses end early where they promise too little
    to be ``_better``.
    """
    row = plain_row(0.0, 0.0, 0.0)
    if BASE[0] not in names:
        row[:3] = base.row[:3]
    problem = ServoProblem(base.problem.traces, row, prior.of(names), prior.ties)
    lossy = not set(LOSSES).isdisjoint(names)
    if not lossy:
        starts = drawn(problem, base, rng, draws=64, most=4) if starts is None else starts
        return fit(problem, starts)
    rival = None
    if starts is None:
        rival = base, len(names) - len(base.names) + 3.0  # half of what is significant
        starts = drawn(problem, base, rng, most=3 if SOFT[0] in names else 12)
    return fit(problem, starts, behind=200.0, rival=rival, rng=rng)


def _likeliest(options: Sequence[Fit]) -> Fit:
    """The fit with the largest evidence, for residuals like those of the best fit."""
    best = min(options, key=lambda motor: motor.scale_rad**2 * motor.inflation)
    return max(options, key=lambda motor: motor.evidence(best.scale_rad, best.inflation))


def _better(fewer: Fit, more: Fit, added: int) -> bool:
    """Whether ``added`` parameters decrease the loss significantly, for residuals like theirs."""
    noise = more.scale_rad, more.inflation
    return fewer.loss(*noise) - more.loss(*noise) > 2 * added + 6
