"""Identification of a model of all servos from recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.effects import named
from sim2real.effects.effect import Effect
from sim2real.errors import InputError, check_choice, check_positive, check_whole, names_of
from sim2real.identification import advice
from sim2real.identification.joint_fit import choose_motor, fit_effects, fit_plain
from sim2real.identification.priors import MOTOR_SHEET, gains
from sim2real.identification.problem import Fit
from sim2real.identification.reading_noise import left_out, while_powered, with_reading_noise
from sim2real.identification.search import error_on, errors_of, fit
from sim2real.identification.uncertainty import (
    beyond_data_sheet,
    intervals,
    standard_errors,
    uncertainty,
)
from sim2real.inference.correlated_noise import correlation_samples, whiteness
from sim2real.inference.normal import LEVEL
from sim2real.model import FittedEffect, JointModel, Law, Model
from sim2real.output import provenance
from sim2real.plausible import admitted
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot, Servo, match_recordings
from sim2real.servo.parameters import (
    BASE,
    COLUMNS,
    CONTROL_SIDE,
    GAINS,
    LOOP,
    TRAINS,
    motor_of,
    stated,
)
from sim2real.servo.trace import (
    Trace,
    at_one_gain,
    check_samples,
    firmware_gain,
    sensor_noise,
    shows_inertia,
    split,
    traces,
)

if TYPE_CHECKING:
    from pandas import DataFrame


def identify(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    held_out: str | None = None,
    effects: str | Sequence[str] = (),
    law: Law | None = None,
    effort: float = 1.0,
    interval: float = LEVEL,
    refit: bool = True,
    seed: int = 0,
    progress: Callable[[Sequence[str]], Sequence[str]] = lambda joints: joints,
) -> Model:
    """Identify the gains and the latency of every servo that moves: ``sim2real.verbs.identify``.

    ``law``: ``"motor"``, with the limit of its torque that the recordings show (``fit_limit``) and
    with gear friction if they show it; ``"pd"``, the linear servo. By default the motor, or the
    linear servo if ``effects`` are given or the data sheet states no torque or no speed, with a
    note in the latter case. ``effort`` multiplies the largest number of evaluations. With ``refit``
    the model, once it is scored on held-out data, is chosen and fitted again on all recordings.
    ``progress`` wraps the sequence of joints.

    Raises:
        InputError: If no joint moves, a recording and the robot do not agree, or a law or an effect
            does not exist.
    """
    if law is not None:
        check_choice("identify", "law", law, ("pd", "motor"))
    check_whole("identify", "seed", seed)
    check_positive("identify", "interval", interval, 1.0, "between 0 and 1")
    extra = tuple(named(effect) for effect in names_of("identify", "effects", effects))
    _check_inputs(recordings, robot, held_out)
    recordings, warnings = admitted(at_one_gain(recordings), robot)
    recorded = [j.name for j in robot.joints if any(j.name in r.joints for r in recordings)]
    moving = [joint for joint in recorded if traces(recordings, joint)]
    if not moving:
        place = f"{recorded[0]}.position_rad"
        found, expected = "no motion", "commands and angles that change"
        raise InputError(recordings[0].file, place, found, expected)
    options = _Options(law, held_out, extra, effort, interval, refit, bool(warnings))
    with ThreadPoolExecutor(2) as pool:  # to keep the processor busy between rollouts
        running = {
            joint: pool.submit(_identify_joint, recordings, robot, joint, options, seed + k)
            for k, joint in enumerate(moving)
        }
        results = {joint: running[joint].result() for joint in progress(moving)}
    inputs = [r.path for r in recordings if r.path] + ([robot.path] if robot.path else [])
    origin = provenance(inputs, seed)
    return Model(
        joints={joint: model for joint, (model, *_) in results.items()},
        fit={f"{joint}.position_rad": figures for joint, (_, figures, *_) in results.items()},
        notes=warnings + advice.on_recordings(recordings, [j for j in recorded if j not in moving]),
        provenance=origin | {"held_out": {j: held for j, (_, _, held, _) in results.items()}},
        firmware_p_gain=next(filter(None, map(firmware_gain, recordings)), None),
        interval_level=interval,
        residuals=_residuals({joint: found for joint, (*_, found) in results.items()}),
    )


def fitted_joint(data: list[Trace], servo: Servo | None, seed: int = 0) -> JointModel:
    """The model of one joint as of ``identify``, without intervals and notes."""
    sheet = servo if servo is not None and servo.states(*MOTOR_SHEET) else None
    data, found = _fits_while_powered(data, sheet, _Options(), seed)
    if split(data, None)[1]:
        found = _fits(data, sheet, _Options(), seed, found)
    return _joint_model(found, data[0].load)


def _check_inputs(recordings: Sequence[Recording], robot: Robot, held_out: str | None) -> None:
    """Check that recordings, robot and the held-out name agree."""
    match_recordings(recordings, robot)
    for recording in recordings:
        if np.isnan(recording.command).all():
            found, expected = "no J.command_rad column", "the set-points that were sent"
            raise InputError(recording.file, "header", found, expected)
        other = recordings[0]
        for joint in set(recording.joints) & set(other.joints):
            if (joint in recording.loads) != (joint in other.loads):
                found = f"a load for {joint} here or in {other.file}, not in both"
                raise InputError(recording.file, "loads", found, "one in all or in none")
    names = [recording.name for recording in recordings]
    if held_out is not None and held_out not in names:
        raise InputError("--held-out", "", repr(held_out), f"one of {', '.join(names)}")


@dataclass(frozen=True)
class _Options:
    """Settings of ``identify`` that are the same for all joints, and whether there are warnings."""

    law: Law | None = None
    held_out: str | None = None
    effects: tuple[Effect, ...] = ()
    effort: float = 1.0
    interval: float = LEVEL
    refit: bool = True
    warned: bool = False


@dataclass(frozen=True)
class _JointFits:
    """Fits of one joint: the linear servo, a motor, without effects (one of the two) and with."""

    plain: Fit
    without_influence: list[str]
    motor: Fit | None
    base: Fit
    best: Fit


def _fits(
    data: list[Trace],
    servo: Servo | None,
    options: _Options,
    seed: int,
    before: _JointFits | None = None,
) -> _JointFits:
    """Choose what is fitted to one joint, from the fits to a part of the data if there are some."""
    rng, effects = np.random.default_rng(seed), options.effects

    def again(fewer: Fit) -> Fit:
        problem = replace(fewer.problem, traces=data)
        return fit(problem, fewer.minima, rounds=3, first=10, later=10, effort=options.effort)

    if before is None or before.without_influence:
        plain, without_influence = fit_plain(data, rng, servo, options.effort)
    else:
        plain, without_influence = again(before.plain), []
    motor: Fit | None = None
    if servo is not None and not without_influence:
        losses = not effects or data[0].varying is None
        fewer = None if before is None else before.motor
        motor = choose_motor(plain, servo, rng, losses=losses, set_points=not effects, before=fewer)
    base = best = motor if motor is not None and BASE[0] in motor.names else plain
    if effects:
        best = fit_effects(base, effects, rng) if before is None else again(before.best)
    return _JointFits(plain, without_influence, motor, base, best)


def _fits_while_powered(
    data: list[Trace], servo: Servo | None, options: _Options, seed: int
) -> tuple[list[Trace], _JointFits]:
    """The traces without releases of the servo, and the fits to those not held out."""
    # A release is one for the linear servo and for the motor, which may have the friction that
    # holds the shaft; both are fitted again without it, and tell better then.
    kept, found = data, _fits(split(data, options.held_out)[0], servo, options, seed)
    for _ in range(2):
        powered = while_powered(data, found.plain.row, found.best.row)
        if all((a.used == b.used).all() for a, b in zip(powered, kept, strict=True)):
            break
        kept = powered
        found = _fits(split(kept, options.held_out)[0], servo, options, seed)
    return kept, found


def _identify_joint(
    recordings: Sequence[Recording], robot: Robot, joint: str, options: _Options, seed: int
) -> tuple[JointModel, dict[str, float | None], str, Fit]:
    """The model of one joint, its errors, what was held out for them, and the fit."""
    data, notes = with_reading_noise(traces(recordings, joint), slow=True), list[str]()
    check_samples(split(data, options.held_out)[0], joint)
    described, servo = robot.joint(joint), None
    if described is not None and options.law != "pd":
        if options.law == "motor" or not options.effects and described.servo.states(*MOTOR_SHEET):
            servo = described.servo
        elif not options.effects:
            notes += advice.on_data_sheet(described.servo)
    load, pendulum = data[0].load, shows_inertia(data)
    data, found = _fits_while_powered(data, servo, options, seed)
    _, scored, held_out_name = split(data, options.held_out)
    notes += left_out(data)
    figures = {"heldout": error_on(found.best.row, scored)}
    if options.effects:
        figures["heldout_without_effects"] = error_on(found.base.row, scored)
        figures["train_without_effects"] = error_on(found.base.row, found.base.problem.traces)
        if not pendulum and any(e.name == "unmodelled_inertia" for e in options.effects):
            notes.append(
                "unmodelled_inertia is not identifiable: it needs a pendulum or two known loads"
            )
    known = load is not PER_INERTIA and data[0].varying is None and pendulum
    if found.best is found.plain and known:
        notes += advice.on_inertia(found.best, scored, load)
    if scored and options.refit:  # now that it has been scored
        found = _fits(data, servo, options, seed, found)
    best, motor = found.best, found.motor
    spread = uncertainty(best, level=options.interval)
    ends = {p.name: (p.low, np.inf) for p in gains(best.inertia)} | intervals(best, spread)
    by_prior: tuple[str, ...] = ()
    if not options.effects:
        notes += advice.on_optima(best, spread)
    if motor is not None and servo is not None:
        motor_spread = spread if motor is best else uncertainty(motor, level=options.interval)
        notes += advice.on_motor(motor, motor_spread, servo)
        by_prior = advice.by_prior(motor, motor_spread)
        ends = intervals(motor, motor_spread) | ends
        wait, latency = 0.5 * float(motor.row[COLUMNS.index(LOOP[0])]), float(best.row[2])
        if wait > 0:
            ends["latency_s"] = (max(latency - wait, 0.0), latency + wait)
        ends |= beyond_data_sheet(motor, ends, servo)
    ringing = advice.on_ringing(best, best.problem.traces)
    if ringing:
        ends |= {name: (0.0, np.inf) for name in GAINS}
    notes += ringing + advice.on_weight(found.plain)
    errors = [e for e in best.residuals if e.size]
    time = float(np.mean([correlation_samples(e) for e in errors]))
    figures = {
        "train": error_on(best.row, best.problem.traces),
        "heldout": None,
        "noise": sensor_noise(data),
        "whiteness": whiteness(errors),
        "correlation_time_s": time * best.problem.traces[0].period_s,
        "robust_outliers": float(np.mean(np.abs(best.error) > 4 * best.scale_rad)),
    } | figures
    notes += advice.on_fit(best, spread, ends, found.without_influence, figures, options.warned)
    known_by = {"by_prior": by_prior, "standard_error": standard_errors(best, spread, ends)}
    told = {"interval": ends, "correlation": spread.correlation(best.names), "notes": tuple(notes)}
    return _joint_model(found, load, **told, **known_by), figures, held_out_name, best


def _residuals(fits: Mapping[str, Fit]) -> DataFrame:
    """Measured less simulated angles of all joints, a row for each sample (``Model``)."""
    from pandas import DataFrame, concat

    parts = []
    for joint, found in fits.items():
        data = found.problem.traces
        for trace, error in zip(data, errors_of(found.row, data), strict=True):
            of = {"joint": joint, "recording": trace.name}
            parts.append(DataFrame({**of, "t_s": trace.t[trace.used], "residual_rad": -error}))
    return concat(parts, ignore_index=True)


def _joint_model(found: _JointFits, load: Load, **told: Any) -> JointModel:  # noqa: ANN401
    """The model of a joint, with these further fields."""
    best, motor = found.best, found.motor
    of_law = motor.effects if motor is not None else ()
    effects = {fitted.effect: dict(fitted.parameters) for fitted in of_law}
    for name, value in zip(best.names, best.values, strict=True):
        effect, _, parameter = name.rpartition(".")
        if effect and effect != "motor":
            effects.setdefault(effect, {})[parameter] = float(value)
    for effect, values in effects.items():  # the controller's side was held
        if effect in TRAINS and (side := best.row[COLUMNS.index(f"{effect}.{CONTROL_SIDE}")]):
            values[CONTROL_SIDE] = float(side)
    model = stated(best.row, load, [FittedEffect(*entry) for entry in effects.items()])
    fitted = motor is None or any(name.startswith("motor.") for name in best.names)
    return replace(
        model,
        law="pd" if motor is None else motor.law,
        motor=motor_of(best.row if fitted or motor is None else motor.row),
        **told,
    )
