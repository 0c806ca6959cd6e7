"""Selection of the limit of a motor's torque: torque-speed line, flat limit, or both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.fit import Fit
from sim2real.identification.motor_fit import EXPLAINED, MotorFit, fit_motor
from sim2real.identification.motor_prior import MotorPrior
from sim2real.identification.servo_problem import FLAT_COLUMNS, LINE_COLUMNS
from sim2real.inference.least_squares import rms
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import CURRENT_LIMIT, LINE
from sim2real.servo.trace import Trace


def fit_limit(
    traces: Sequence[Trace],
    plain: Fit,
    prior: MotorPrior,
    free_names: Sequence[str],
    rng: np.random.Generator,
    *,
    noise: float,
    gains: bool = True,
    plausible_sd: float = 2.0,
    current_limits: Sequence[float] = (0.85, 0.6),
) -> MotorFit:
    """Fit a motor with the likeliest limit of its torque.

    A drive limited in voltage has the torque-speed line of its data sheet. One limited in current
    has a flat limit, whatever the speed, and its damping acts in addition: the same law, in which
    the no-load speed follows from the damping instead of the data sheet (``MotorPrior.flat``). Both
    at once are a line and a current limit below its stall torque. The flat limit is tried where a
    line contradicts the no-load speed of the data sheet, both where one limit leaves a residual;
    the larger evidence decides.

    Args:
        traces: The joint's recordings.
        plain: The fit of the linear servo.
        prior: Prior of the parameters, with the line of the data sheet.
        free_names: Columns to fit in addition to gains and latency, those of the line among them.
        rng: Generator for the candidates.
        noise: Standard deviation of the sensor's noise in rad.
        gains: Whether gains and latency are fitted; else those of the linear servo are kept.
        plausible_sd: Deviation of the no-load speed from the data sheet, in standard deviations of
            its prior, up to which no flat limit is tried.
        current_limits: Current limits from which fits start, as shares of the stall torque.
    """
    line = fit_motor(traces, plain, prior, free_names, rng, gains=gains)
    if prior.drive is not None or traces[0].load is PER_INERTIA:
        return line  # the drive is known, or the unit of torque is not
    options, speed = [line], prior.parameters[prior.index(LINE[1])]
    plausible = min(speed.nominal + plausible_sd * speed.prior_sd, np.log(speed.high) - 1e-3)
    if line.x[prior.index(LINE[1])] > plausible:
        flat = prior.flat(float(plain.row[1]))
        start = line.x.copy()
        start[prior.index(LINE[1])] = flat.parameters[prior.index(LINE[1])].nominal
        options.append(
            fit_motor(traces, plain, flat, free_names, rng, starts=start[None], gains=gains)
        )
    best = _likeliest(options)
    if gains and current_limits and rms(best.fit.residuals) > EXPLAINED * noise:
        starts = np.tile(line.x, (len(current_limits), 1))
        for name in LINE:
            starts[:, prior.index(name)] = prior.parameters[prior.index(name)].nominal
        stall = prior.parameters[prior.index(LINE[0])].nominal
        starts[:, prior.index(CURRENT_LIMIT)] = stall + np.log(current_limits)
        names = (*free_names, CURRENT_LIMIT)
        both = fit_motor(traces, plain, prior, names, rng, starts=starts)
        best = _likeliest([best, both])
    return best


def _likeliest(options: Sequence[MotorFit]) -> MotorFit:
    """The fit with the largest evidence, for residuals like those of the best fit."""
    best = min(options, key=lambda motor: motor.fit.scale_rad**2 * motor.inflation)
    scale, inflation = best.fit.scale_rad, best.inflation
    return max(options, key=lambda motor: motor.evidence(scale, inflation))


def without_flat_limit(row: Array) -> Array:
    """A servo's parameters (P,), a flat limit of its effects as the limit of its motor's law."""
    limit, share = (float(x) for x in row[FLAT_COLUMNS])
    moved = row.copy()
    moved[FLAT_COLUMNS] = 0.0
    damping = max(share, 1e-2) * max(float(row[1]), 1e-9)
    moved[LINE_COLUMNS] = limit, limit / damping
    return moved
