"""Which parts of a motor's law recordings ask for: the line, losses, soft friction, a loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.identification.control_loop import sampled
from sim2real.identification.fit import Fit
from sim2real.identification.motor_fit import EXPLAINED, MotorFit, averaged, fit_motor, softer
from sim2real.identification.motor_prior import MotorPrior, motor_prior
from sim2real.identification.servo_type import ServoType
from sim2real.inference.correlated_noise import whiteness
from sim2real.inference.least_squares import rms
from sim2real.recording import PER_INERTIA
from sim2real.robot import Servo
from sim2real.servo.parameters import LINE, LOSSES, ROTOR, SOFT
from sim2real.servo.trace import Trace, shows_inertia

FACTORS = (0.5, 2.0)
"""How much narrower and wider the prior of losses may be as well."""


@dataclass(frozen=True)
class MotorCriteria:
    """From when on a part of the motor's law is taken.

    Attributes:
        min_gain: What a choice must gain beyond chance.
        loop_parameters: Parameters that a sampled loop counts for: the best of a thousand periods
            and phases.
        white: Lag-1 autocorrelation of a residual in which nothing is left.
        loop_error_before: Largest residual without a loop, in noises, for one to be told.
        loop_error_after: Largest residual with it, in noises.
    """

    min_gain: float = 6.0
    loop_parameters: int = 12
    white: float = 0.1
    loop_error_before: float = 15.0
    loop_error_after: float = 1.5


MOTOR_CRITERIA = MotorCriteria()
"""The defaults."""


def choose_motor(
    fitted: list[Trace],
    plain: Fit,
    servo: Servo,
    noise: float,
    rng: np.random.Generator,
    known: ServoType | None = None,
    *,
    average: bool = False,
    criteria: MotorCriteria = MOTOR_CRITERIA,
) -> MotorFit:
    """The motor's line alone where that explains the recordings, else its losses as well.

    Where the linear servo explains them the gains stay, and the line comes as near as they allow.
    Losses are taken where they lower the loss by more than chance and their number account for:
    twice the number of parameters, as Akaike's criterion has it, and ``criteria.min_gain`` more. So
    are, while something is left, friction that stops softly and a sampled loop. A servo of a known
    type has the losses of its type.

    Args:
        fitted: The joint's recordings.
        plain: The fit of the linear servo.
        servo: Its data sheet.
        noise: Of its sensor, rad.
        rng: For starts.
        known: What is known of servos of its type.
        average: Whether losses that leave something are averaged over how wide their prior may be,
            which nothing on the recordings says: half and twice as wide as well, if the load is
            known.
        criteria: What must be gained.
    """
    prior = motor_prior(servo, fitted)
    if known is not None:
        prior = known.prior(prior, per_inertia=fitted[0].load is PER_INERTIA)
    if rms(plain.residuals) < EXPLAINED * noise:
        return fit_motor(fitted, plain, prior, LINE, rng, gains=False)
    chosen = _continuous(fitted, plain, prior, noise, rng, known, criteria=criteria)
    left = rms(chosen.fit.residuals) / noise
    explained = left < EXPLAINED and whiteness(chosen.fit.residuals) < criteria.white
    looped = None if explained or left > criteria.loop_error_before else sampled(chosen)
    if looped is not None and rms(looped.fit.residuals) <= criteria.loop_error_after * noise:
        return _better(chosen, looped, criteria.loop_parameters, criteria=criteria)
    names = [prior.names[k] for k in chosen.problem.free[3:]]
    stated = fitted[0].load is not PER_INERTIA  # else minima lie too far apart to be averaged
    if not (average and stated) or known is not None or left < EXPLAINED or LOSSES[0] not in names:
        return chosen
    others = [fit_motor(fitted, plain, prior.loosened(factor), names, rng) for factor in FACTORS]
    return averaged([chosen, *others])


def _continuous(
    fitted: list[Trace],
    plain: Fit,
    prior: MotorPrior,
    noise: float,
    rng: np.random.Generator,
    known: ServoType | None,
    *,
    criteria: MotorCriteria,
) -> MotorFit:
    """The motor whose controller looks all the time."""
    line = (*LINE, ROTOR) if shows_inertia(fitted) else LINE
    if known is not None and set(known.parameters) & set(LOSSES):  # nothing to choose
        softness = SOFT if set(known.parameters) & set(SOFT) else ()
        return fit_motor(fitted, plain, prior, (*line, *LOSSES, *softness), rng)
    first = fit_motor(fitted, plain, prior, line, rng)
    if rms(first.fit.residuals) < EXPLAINED * noise:
        return first
    full = fit_motor(fitted, plain, prior, (*line, *LOSSES), rng, start=first.x)
    chosen = _better(first, full, len(LOSSES), criteria=criteria)
    if rms(chosen.fit.residuals) < EXPLAINED * noise:
        return chosen
    soft = fit_motor(fitted, plain, prior, (*line, *LOSSES, *SOFT), rng, starts=softer(full))
    return _better(
        chosen, soft, len(SOFT) + (len(LOSSES) if chosen is first else 0), criteria=criteria
    )


def _better(fewer: MotorFit, more: MotorFit, added: int, *, criteria: MotorCriteria) -> MotorFit:
    """The fit with so many more parameters, where they gain more than chance."""
    scale, inflation = more.fit.scale_rad, more.inflation
    gain = fewer.loss_at(scale, inflation) - more.loss_at(scale, inflation)
    return more if gain > 2 * added + criteria.min_gain else fewer
