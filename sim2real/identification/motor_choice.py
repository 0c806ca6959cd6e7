"""Selection of the parts of a motor's law: limit, losses, gradual friction, sampled loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.control_loop import fit_sampled_loop
from sim2real.identification.fit import Fit
from sim2real.identification.motor_fit import EXPLAINED, MotorFit, fit_motor
from sim2real.identification.motor_prior import MotorPrior, motor_prior
from sim2real.identification.torque_limit import fit_limit
from sim2real.inference.correlated_noise import whiteness
from sim2real.inference.least_squares import rms
from sim2real.robot import Servo
from sim2real.servo.parameters import LINE, LOSSES, ROTOR, SOFT
from sim2real.servo.trace import Trace, shows_inertia


def choose_motor(
    fitted: list[Trace],
    plain: Fit,
    servo: Servo,
    noise: float,
    rng: np.random.Generator,
    *,
    losses: bool = True,
    white: float = 0.1,
    error_before_loop: float = 15.0,
    error_with_loop: float = 1.5,
    loop_parameters: int = 12,
) -> MotorFit:
    """Fit the limit of the motor's torque and, if that does not explain the recordings, its losses.

    Where the linear servo explains them, its gains are kept and only the limit is fitted. Losses
    are included if they decrease the loss by clearly more than twice their number (Akaike's
    criterion). The same applies to gradual friction and a sampled loop if a residual remains.

    Args:
        fitted: The joint's recordings.
        plain: The fit of the linear servo.
        servo: Its data sheet.
        noise: Standard deviation of its sensor noise in rad.
        rng: Generator for starts.
        losses: Whether losses may be included; without them, as where effects are fitted instead,
            the motor's line and rotor are fitted.
        white: Lag-1 autocorrelation below which a residual counts as white.
        error_before_loop: Largest residual over noise for which a sampled loop is searched.
        error_with_loop: Largest residual over noise with a loop.
        loop_parameters: Effective parameters of a loop, the best of a thousand periods and phases.
    """
    prior = motor_prior(servo, fitted)
    linear = fitted[0].varying is None  # on an arm the motor's rotor is needed
    if linear and rms(plain.residuals) < EXPLAINED * noise:
        return fit_limit(fitted, plain, prior, LINE, rng, noise=noise, gains=False)
    if not losses:
        return fit_motor(fitted, plain, prior, (*LINE, ROTOR), rng)
    chosen = _fit_continuous(fitted, plain, prior, noise, rng)
    ratio = rms(chosen.fit.residuals) / noise
    explained = ratio < EXPLAINED and whiteness(chosen.fit.residuals) < white
    looped = None if explained or ratio > error_before_loop else fit_sampled_loop(chosen)
    if looped is not None and rms(looped.fit.residuals) <= error_with_loop * noise:
        return _better(chosen, looped, loop_parameters)
    return chosen


def _fit_continuous(
    fitted: list[Trace],
    plain: Fit,
    prior: MotorPrior,
    noise: float,
    rng: np.random.Generator,
    *,
    least_gain: float = 2.0,
) -> MotorFit:
    """Fit a motor with a continuous controller.

    Losses are not searched further where the first steps of all searches decrease half the loss by
    less than ``least_gain``, a fifth of what they need to be chosen; nor is gradual friction then.
    """
    line: tuple[str, ...] = (*LINE, ROTOR) if shows_inertia(fitted) else LINE
    first = fit_limit(fitted, plain, prior, line, rng, noise=noise)
    prior, line = first.problem.prior, first.free_names
    if rms(first.fit.residuals) < EXPLAINED * noise:
        return first
    full = fit_motor(
        fitted,
        plain,
        prior,
        (*line, *LOSSES),
        rng,
        start=first.x,
        candidates=512,
        searches=24,
        first_steps=40,
        later_steps=25,
        behind=200.0,
        least_gain=least_gain,
    )
    chosen = _better(first, full)
    without = _gain(first, full) < 2 * least_gain  # and so without friction that could be gradual
    if without or rms(chosen.fit.residuals) < EXPLAINED * noise:
        return chosen
    soft = fit_motor(fitted, plain, prior, (*line, *LOSSES, *SOFT), rng, starts=_soft_starts(full))
    return _better(chosen, soft)


def _better(
    fewer: MotorFit, more: MotorFit, added: int | None = None, *, beyond_chance: float = 6.0
) -> MotorFit:
    """The fit with more parameters if they decrease the loss significantly, else the other."""
    if added is None:
        added = len(more.problem.free) - len(fewer.problem.free)
    return more if _gain(fewer, more) > 2 * added + beyond_chance else fewer


def _gain(fewer: MotorFit, more: MotorFit) -> float:
    """Decrease of the loss by more parameters, for residuals like theirs."""
    scale, inflation = more.fit.scale_rad, more.inflation
    return fewer.loss_at(scale, inflation) - more.loss_at(scale, inflation)


def _soft_starts(
    motor: MotorFit,
    times_s: Sequence[tuple[float, float]] = ((1e-3, 3e-4), (0.01, 1e-3), (0.01, 5e-3)),
) -> Array:
    """Starts as searched (S, F) from a fit, with gradual friction.

    Their stick and creep times are nearly 0, MuJoCo's, and larger ones.
    """
    x = np.tile(motor.x, (len(times_s), 1))
    x[:, [motor.problem.prior.index(name) for name in SOFT]] = times_s
    return x
