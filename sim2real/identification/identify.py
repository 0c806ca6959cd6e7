"""Identification of a model of all servos from recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sim2real.arrays import Array
from sim2real.effects import Effect, named
from sim2real.errors import InputError, check_choice, check_whole, names_of
from sim2real.identification import advice
from sim2real.identification.effect_fit import fit_effects
from sim2real.identification.fit import (
    Fit,
    best_of,
    first_guess,
    fit,
    gains,
    inertia_left_out,
    plain_parameters,
    residuals,
)
from sim2real.identification.motor_choice import choose_motor
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.motor_prior import nominal_rotor
from sim2real.identification.uncertainty import (
    GAINS,
    Uncertainty,
    as_good,
    beyond_data_sheet,
    intervals,
    motor_intervals,
    symmetric_intervals,
    uncertainty,
)
from sim2real.inference.correlated_noise import correlation_samples, whiteness
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import column
from sim2real.model import FittedEffect, JointModel, Law, Model
from sim2real.output import provenance
from sim2real.plausible import admitted
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot, Servo, match_recordings
from sim2real.servo.linearised import fastest_visible_rad_s, ringing_rad_s
from sim2real.servo.parameters import INERTIA_LEFT_OUT, motor_of, stated
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

MOTOR_SHEET = ("max_torque_Nm", "no_load_speed_rad_s")
"""What a data sheet must state for the law ``motor``."""
_SIDE_BY_SIDE = 2
"""Number of joints fitted concurrently, to keep the processor busy between rollouts."""


@dataclass(frozen=True)
class JointFit:
    """Result of the fit of one joint."""

    model: JointModel
    figures: dict[str, float | None]
    held_out: str


def identify(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    held_out: str | None = None,
    effects: str | Sequence[str] = (),
    law: Law | None = None,
    effort: float = 1.0,
    seed: int = 0,
    progress: Callable[[Sequence[str]], Sequence[str]] = lambda joints: joints,
) -> Model:
    """Identify the gains and the latency of every servo that moves.

    Args:
        recordings: Recordings of the servos; all of one joint are fitted together.
        robot: The robot that was recorded.
        held_out: Name of the recording to score on and not to fit; the last one by default. The
            last quarter of a single recording is held out.
        effects: Names of effects, or one name, to fit together with the gains of every joint.
        law: ``"motor"``: a motor with the limit of its torque that the recordings show (the line of
            its data sheet, a flat limit, or both; ``torque_limit.fit_limit``), and with gear
            friction if they show it; ``"pd"``: the linear servo. By default the motor, or the
            linear servo if ``effects`` are given or the data sheet states no torque or no speed,
            with a note in the latter case.
        effort: Multiple of the largest number of evaluations of a search.
        seed: Seed of the search for a starting point.
        progress: Function that wraps the sequence of joints, to show progress.

    Returns:
        The model, with 90 % intervals, errors on fitted and held-out data, and notes.

    Raises:
        InputError: If no joint moves, a recording and the robot do not agree, or a law or an effect
            does not exist.
    """
    if law is not None:
        check_choice("identify", "law", law, ("pd", "motor"))
    check_whole("identify", "seed", seed)
    extra = [named(effect) for effect in names_of("identify", "effects", effects)]
    _check_inputs(recordings, robot, held_out)
    recordings, warnings = admitted(at_one_gain(recordings), robot)
    recorded = [j.name for j in robot.joints if any(j.name in r.joints for r in recordings)]
    moving = [joint for joint in recorded if traces(recordings, joint)]
    if not moving:
        place = f"{recorded[0]}.position_rad"
        found, expected = "no motion", "commands and angles that change"
        raise InputError(recordings[0].file, place, found, expected)
    # Each joint has a separate random generator, so that joints can be fitted concurrently.
    streams = dict(zip(moving, np.random.default_rng(seed).spawn(len(moving)), strict=True))
    servos = {joint: _servo(robot, joint, law or ("pd" if extra else None)) for joint in moving}

    def identify_joint(joint: str) -> JointFit:
        data = traces(recordings, joint)
        check_samples(split(data, held_out)[0], joint)
        notes = []
        if law is None and not extra and servos[joint] is None:
            notes = advice.on_data_sheet(robot, joint, MOTOR_SHEET)
        options = (held_out, extra, streams[joint], servos[joint], notes, bool(warnings))
        return _identify_joint(data, *options, effort)

    with ThreadPoolExecutor(_SIDE_BY_SIDE) as pool:
        running = {joint: pool.submit(identify_joint, joint) for joint in moving}
        results = {joint: running[joint].result() for joint in progress(moving)}
    inputs = [r.path for r in recordings if r.path] + ([robot.path] if robot.path else [])
    origin = provenance(inputs, seed)
    return Model(
        joints={joint: result.model for joint, result in results.items()},
        fit={f"{joint}.position_rad": result.figures for joint, result in results.items()},
        notes=warnings
        + advice.on_recordings(recordings, [j for j in recorded if j not in moving])
        + advice.on_gains(recordings)
        + advice.on_play(recordings),
        provenance=origin | {"held_out": {j: result.held_out for j, result in results.items()}},
        firmware_p_gain=next(filter(None, map(firmware_gain, recordings)), None),
    )


def _servo(robot: Robot, joint: str, law: Law | None) -> Servo | None:
    """The joint's data sheet; None for the linear law.

    The default law is that of the motor if the data sheet states the values that it needs.
    """
    described = robot.joint(joint)
    if law == "pd" or described is None:
        return None
    return described.servo if law == "motor" or described.servo.states(*MOTOR_SHEET) else None


def _check_inputs(recordings: Sequence[Recording], robot: Robot, held_out: str | None) -> None:
    """Check that recordings, robot and the held-out name agree."""
    match_recordings(recordings, robot)
    for recording in recordings:
        if np.isnan(recording.command).all():
            found, expected = "no J.command_rad column", "the set-points that were sent"
            raise InputError(recording.file, "header", found, expected)
        for other in recordings[:1]:
            for joint in set(recording.joints) & set(other.joints):
                if (joint in recording.loads) != (joint in other.loads):
                    found = f"a load for {joint} here or in {other.file}, not in both"
                    raise InputError(recording.file, "loads", found, "one in all or in none")
    names = [recording.name for recording in recordings]
    if held_out is not None and held_out not in names:
        raise InputError("--held-out", "", repr(held_out), f"one of {', '.join(names)}")


def _identify_joint(
    data: list[Trace],
    held_out: str | None,
    extra: list[Effect],
    rng: np.random.Generator,
    servo: Servo | None,
    notes: list[str],
    warned: bool,
    effort: float,
) -> JointFit:
    fitted, scored, held_out_name = split(data, held_out)
    load = data[0].load
    noise = sensor_noise(fitted)
    best, rivals, without_influence = _fit_plain(fitted, noise, rng, servo, effort)
    motor = None
    if servo is not None and not without_influence:
        losses = not extra or fitted[0].varying is None
        motor = choose_motor(fitted, best, servo, noise, rng, losses=losses)
    if motor is not None and motor.with_gains:
        best, rivals = motor.fit, []
    figures = _figures(best, residuals(best.row, scored), fitted, noise)
    if extra:
        without = {f"{key}_without_effects": figures[key] for key in ("train", "heldout")}
        best = fit_effects(fitted, best, extra, rng)
        units = column(best.parameters, "typical")
        spread = uncertainty(best, units, fitted)
        ends = symmetric_intervals(best, spread, units)
        figures = _figures(best, residuals(best.row, scored), fitted, noise) | without
        if not shows_inertia(fitted) and any(e.name == "unmodelled_inertia" for e in extra):
            notes.append(
                "unmodelled_inertia is not identifiable: it needs a pendulum or two known loads"
            )
    elif motor is not None and motor.with_gains:
        spread = uncertainty(best, motor.units, fitted)
        ends = motor_intervals(motor, spread)
        optima = list(motor.other_values)
        notes += advice.on_optima(best.names, best.values, spread.half_width, optima)
    else:
        if load is not PER_INERTIA and fitted[0].varying is None and shows_inertia(fitted):
            notes += advice.on_inertia(best, _with_inertia(fitted, best), scored, load)
        free = plain_parameters(fitted, best.row)
        units = np.array([p.typical for p in free if p.name in best.names])
        spread = uncertainty(best, units, fitted)
        ends = intervals(best, rivals, spread, units, fitted)
        optima = [other.values for other in as_good(rivals, best, spread)]
        notes += advice.on_optima(best.names, best.values, spread.half_width, optima)
    if motor is not None and servo is not None:
        motor_spread = spread
        if best is not motor.fit:
            motor_spread = uncertainty(motor.fit, motor.units, fitted)
        notes += advice.on_motor(motor, motor_spread, servo)
        ends = motor_intervals(motor, motor_spread) | ends
        wait = 0.5 * motor.values.get("loop_period_s", 0.0)
        latency = float(best.row[2])
        if wait > 0:
            ends["latency_s"] = (max(latency - wait, 0.0), latency + wait)
        ends |= beyond_data_sheet(motor, ends, servo)
    ringing = advice.on_ringing(best, fitted)
    if ringing:
        ends |= {name: (0.0, np.inf) for name in GAINS}
    notes += ringing + advice.on_weight(fitted)
    notes += advice.on_fit(best, spread, ends, without_influence, figures, warned)
    model = _joint_model(best, ends, spread, load, tuple(notes), motor)
    return JointFit(model, figures, held_out_name)


def _fit_plain(
    fitted: list[Trace],
    noise: float,
    rng: np.random.Generator,
    servo: Servo | None = None,
    effort: float = 1.0,
) -> tuple[Fit, list[Fit], list[str]]:
    """The best fit of gains and latency, its rivals, and parameters without visible influence.

    These change simulated angles by less than the noise and are not fitted.
    """
    start, others = first_guess(fitted, rng, rotor_kgm2=_assumed_rotor(fitted, servo))
    free = plain_parameters(fitted, start)
    slope = np.concatenate(fit(fitted, start, free, rounds=0, evaluations=1).jacobians)
    effect = np.linalg.norm(slope * column(free, "typical"), axis=0)
    names = [p.name for p, size in zip(free, effect, strict=True) if size > noise]
    if not names:
        found = f"no motion above the noise of {1e3 * noise:.2g} mrad"
        raise InputError(fitted[0].file, "", found, "a joint that moves visibly")
    best, rivals = best_of(fitted, [start, *others], names, effort)
    visible = fastest_visible_rad_s(fitted)
    if ringing_rad_s(fitted, best.row) > visible:  # may be an alias of a slower servo
        rotor = _assumed_rotor(fitted, servo)
        start, others = first_guess(fitted, rng, rotor_kgm2=rotor, fastest_rad_s=visible)
        again, more = best_of(fitted, [start, *others], names, effort)
        pool = sorted([best, *rivals, again, *more], key=lambda f: f.loss(again.scale_rad))
        best, rivals = pool[0], pool[1:]
    return best, rivals, [p.name for p in free if p.name not in names]


def _assumed_rotor(fitted: Sequence[Trace], servo: Servo | None) -> float:
    """Rotor inertia in kg m2 from which the fit of an arm's servo starts, and 0 of others."""
    if fitted[0].varying is None:
        return 0.0
    if servo is None:
        return fitted[0].load.inertia_kgm2
    return nominal_rotor(servo)


def _with_inertia(fitted: list[Trace], best: Fit) -> Fit:
    """Fit again with free inertia, from the given fit and from one with more inertia."""
    heavier = best.row.copy()
    heavier[:3] *= 1.3, 1.3, 0.3
    heavier[INERTIA_LEFT_OUT] = 0.3 * best.inertia
    fits = [
        fit(fitted, row, (*gains(row, best.inertia), inertia_left_out(row, best.inertia)))
        for row in (best.row, heavier)
    ]
    return min(fits, key=lambda candidate: candidate.loss(best.scale_rad))


def _figures(
    best: Fit, heldout: tuple[Array, ...], fitted: list[Trace], noise: float
) -> dict[str, float | None]:
    errors = [e for e in best.residuals if e.size]
    return {
        "train": rms(errors),
        "heldout": rms(heldout) if heldout else None,
        "noise": noise,
        "whiteness": whiteness(errors),
        "correlation_time_s": float(np.mean([correlation_samples(e) for e in errors]))
        * fitted[0].period_s,
        "robust_outliers": float(np.mean(np.abs(np.concatenate(errors)) > 4 * best.scale_rad)),
    }


def _joint_model(
    best: Fit,
    ends: dict[str, tuple[float, float]],
    spread: Uncertainty,
    load: Load,
    notes: tuple[str, ...],
    motor: MotorFit | None,
) -> JointModel:
    of_law = motor.effects if motor is not None else ()
    effects = {fitted.effect: dict(fitted.parameters) for fitted in of_law}
    for name, value in zip(best.names, best.values, strict=True):
        effect, _, parameter = name.rpartition(".")
        if effect and effect != "motor":
            effects.setdefault(effect, {})[parameter] = float(value)
    model = stated(best.row, load, [FittedEffect(*entry) for entry in effects.items()])
    pairs = combinations(range(len(best.names)), 2)
    refitted = any(name.startswith("motor.") for name in best.names)
    motor_parameters = motor_of(best.row) if refitted or motor is None else motor.values
    return replace(
        model,
        law="pd" if motor is None else motor.law,
        motor=motor_parameters,
        interval=ends,
        correlation={
            f"{best.names[i]}, {best.names[j]}": float(spread.correlation[i, j]) for i, j in pairs
        },
        notes=notes,
    )
