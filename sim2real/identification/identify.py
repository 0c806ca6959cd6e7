"""From recordings to a fitted servo model: the first main job."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.arguments import check_choice, check_whole, names_of
from sim2real.effects import Effect, named
from sim2real.errors import InputError
from sim2real.identification import advice
from sim2real.identification.effect_fit import fit_effects
from sim2real.identification.fit import Fit, best_of, fit, gains, inertia_left_out, residuals
from sim2real.identification.initial_guess import first_guess
from sim2real.identification.intervals import intervals, motor_intervals, symmetric_intervals
from sim2real.identification.motor_choice import choose_motor
from sim2real.identification.motor_fit import MotorFit
from sim2real.identification.servo_type import ServoType, learn, type_of
from sim2real.identification.uncertainty import Uncertainty, uncertainty
from sim2real.inference.correlated_noise import correlation_samples, whiteness
from sim2real.inference.least_squares import rms
from sim2real.inference.parameters import column
from sim2real.model import LAWS, FittedEffect, JointModel, Law, Model
from sim2real.output import provenance
from sim2real.plausible import validate_recording
from sim2real.recording import PER_INERTIA, Load, Recording
from sim2real.robot import Robot, Servo, match_recordings
from sim2real.servo.parameters import INERTIA_LEFT_OUT
from sim2real.servo.trace import Trace, check_samples, sensor_noise, shows_inertia, split, traces

Array = NDArray[np.float64]

MOTOR_SHEET = ("max_torque_Nm", "no_load_speed_rad_s")
"""What a data sheet must state for the law ``motor``."""
_SIDE_BY_SIDE = 2
"""Joints fitted at once: one fills the processor while the other prepares its next rollouts."""


@dataclass(frozen=True)
class JointFit:
    """What is known of one joint after its fit."""

    model: JointModel
    figures: dict[str, float | None]
    held_out: str
    motor: MotorFit | None


def identify(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    held_out: str | None = None,
    effects: str | Sequence[str] = (),
    law: Law | None = None,
    together: bool = False,
    seed: int = 0,
    progress: Callable[[Sequence[str]], Sequence[str]] = lambda joints: joints,
) -> Model:
    """Identify the gains and the latency of every servo that moves.

    Args:
        recordings: Recordings of the servos; all of one joint are fitted together.
        robot: The robot that was recorded.
        held_out: Name of the recording to score on and not fit; the last one by default. Of a lone
            recording the last quarter is held out.
        effects: Names of effects, or one name, to fit together with the gains of every joint.
        law: ``"motor"``: a motor on the torque-speed line of its data sheet, whose gears rub where
            the recordings show it; ``"pd"``: the linear servo. By default the motor, and the linear
            servo where ``effects`` say what to add to it or the data sheet states no torque and no
            speed, which a note then says.
        together: Whether joints with one servo in the robot's file have motors of one make: each
            is then fitted again with what the others have told of theirs (``servo_type``).
        seed: Seed of the scan for a start.
        progress: Wraps the joints while they are worked through, to show progress.

    Returns:
        The model, with 90 % intervals, errors on fitted and held-out data, and notes.

    Raises:
        InputError: If no joint moves, a recording and the robot do not agree, there is no such law,
            or the catalogue lacks an effect.
    """
    if law is not None:
        check_choice("identify", "law", law, LAWS)
    check_whole("identify", "seed", seed)
    wanted = [named(effect) for effect in names_of("identify", "effects", effects)]
    _check_inputs(recordings, robot, held_out)
    recorded = [j.name for j in robot.joints if any(j.name in r.joints for r in recordings)]
    moving = [joint for joint in recorded if traces(recordings, joint)]
    if not moving:
        place = f"{recorded[0]}.position_rad"
        found, expected = "no motion", "commands and angles that change"
        raise InputError(recordings[0].file, place, found, expected)
    # Each joint has random numbers of its own, so that joints can be fitted side by side.
    streams = dict(zip(moving, np.random.default_rng(seed).spawn(len(moving)), strict=True))
    servos = {joint: _servo(robot, joint, law or ("pd" if wanted else None)) for joint in moving}
    types = {j: type_of(servo) for j, servo in servos.items() if servo is not None}

    def one(joint: str, known: ServoType | None) -> JointFit:
        given = traces(recordings, joint)
        check_samples(split(given, held_out)[0], joint)
        notes = []
        if law is None and not wanted and servos[joint] is None:
            notes = advice.on_data_sheet(robot, joint, MOTOR_SHEET)
        return _identify_joint(given, held_out, wanted, streams[joint], servos[joint], known, notes)

    with ThreadPoolExecutor(_SIDE_BY_SIDE) as pool:
        running = {joint: pool.submit(one, joint, types.get(joint)) for joint in moving}
        results = {joint: running[joint].result() for joint in progress(moving)}
    if together:
        told = {joint: _told_by_others(joint, servos, results) for joint in moving}
        for joint, known in told.items():
            results[joint] = results[joint] if known is None else one(joint, known)
    inputs = [r.path for r in recordings if r.path] + ([robot.path] if robot.path else [])
    origin = provenance(inputs, seed)
    return Model(
        joints={joint: result.model for joint, result in results.items()},
        fit={f"{joint}.position_rad": result.figures for joint, result in results.items()},
        notes=advice.on_recordings(recordings, [j for j in recorded if j not in moving]),
        provenance=origin | {"held_out": {j: result.held_out for j, result in results.items()}},
    )


def fitted_motors(
    recordings: Sequence[Recording], robot: Robot, *, seed: int = 0
) -> dict[str, MotorFit]:
    """The motor of every joint that moves, fitted to all of its recordings with nothing held out.

    For ``servo_type.learn``. Joints that a linear servo explains tell nothing of their motors and
    are left out.
    """
    _check_inputs(recordings, robot, None)
    rng = np.random.default_rng(seed)
    found = {}
    for joint in robot.joints:
        given = traces(recordings, joint.name)
        if not given:
            continue
        noise = sensor_noise(given)
        start, others = first_guess(given, rng)
        best, _ = best_of(given, [start, *others], _influential(given, start, noise)[0])
        motor = choose_motor(given, best, joint.servo, noise, rng)
        if motor.with_gains:
            found[joint.name] = motor
    return found


def _servo(robot: Robot, joint: str, law: Law | None) -> Servo | None:
    """The joint's data sheet; None where the law asks for none.

    Without a law it is the motor's where the data sheet states what that needs.
    """
    known = robot.joint(joint)
    if law == "pd" or known is None:
        return None
    return known.servo if law == "motor" or known.servo.states(*MOTOR_SHEET) else None


def _told_by_others(
    joint: str, servos: Mapping[str, Servo | None], results: Mapping[str, JointFit]
) -> ServoType | None:
    """What the other joints with the same servo have told of its motor, if there are any."""
    servo, mine = servos[joint], results[joint].motor
    if servo is None or mine is None:
        return None
    others = {j: r.motor for j, r in results.items() if j != joint and servos[j] == servo}
    motors = [m for m in others.values() if m is not None and m.with_gains]
    if not motors:
        return None
    per_inertia = mine.problem.traces[0].load is PER_INERTIA
    return learn(servo.name, motors, ", ".join(others), per_inertia=per_inertia)


def _check_inputs(recordings: Sequence[Recording], robot: Robot, held_out: str | None) -> None:
    """Make sure that recordings, robot and the wish for what to hold out agree."""
    match_recordings(recordings, robot)
    for recording in recordings:
        validate_recording(recording, robot)
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
    given: list[Trace],
    held_out: str | None,
    wanted: list[Effect],
    rng: np.random.Generator,
    servo: Servo | None,
    known: ServoType | None,
    notes: list[str],
) -> JointFit:
    fitted, scored, held = split(given, held_out)
    noise = sensor_noise(fitted)
    start, others = first_guess(fitted, rng)
    free, unseen = _influential(fitted, start, noise)
    best, rivals = best_of(fitted, [start, *others], free)
    stated = given[0].load
    motor = None
    if servo is not None and not unseen:
        motor = choose_motor(fitted, best, servo, noise, rng, known, average=True)
    if motor is not None and motor.with_gains:
        best, rivals = motor.fit, []
    figures = _figures(best, residuals(best.row, scored), fitted, noise)
    if wanted:
        without = {f"{key}_without_effects": figures[key] for key in ("train", "heldout")}
        best = fit_effects(fitted, best, wanted)
        units = column(best.parameters, "typical")
        spread = uncertainty(best, units)
        ends = symmetric_intervals(best, spread, units)
        figures = _figures(best, residuals(best.row, scored), fitted, noise) | without
        notes += advice.on_effects(wanted, shows_inertia=shows_inertia(fitted))
    elif motor is not None and motor.with_gains:
        spread = uncertainty(best, motor.units)
        ends = motor_intervals(motor, spread)
    else:
        if stated is not PER_INERTIA and shows_inertia(fitted):
            notes += advice.on_inertia(best, _with_inertia(fitted, best), scored, stated)
        units = _units(best)
        spread = uncertainty(best, units)
        ends = intervals(best, rivals, spread, units, fitted)
    if motor is not None and servo is not None:
        own = uncertainty(motor.fit, motor.units)
        notes += advice.on_motor(motor, own, servo)
        ends = motor_intervals(motor, own) | ends
        wait = 0.5 * motor.values.get("loop_period_s", 0.0)
        latency = float(best.row[2])
        if wait > 0:
            ends["latency_s"] = (max(latency - wait, 0.0), latency + wait)
    notes += advice.on_fit(best, spread, ends, unseen, figures)
    model = _joint_model(best, ends, spread, stated, tuple(notes), motor)
    return JointFit(model, figures, held, motor)


def _units(best: Fit) -> Array:
    """Sizes at which a change of each fitted parameter would matter now, shape (F,)."""
    now = {p.name: p.typical for p in gains(best.row, best.inertia)}
    return np.array([now[name] for name in best.names])


def _influential(
    fitted: list[Trace], start: Array, noise: float
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split parameters into those that move the simulated angles above the noise and the others."""
    free = gains(start, fitted[0].load.inertia_kgm2)
    slope = np.concatenate(fit(fitted, start, free, rounds=0, evaluations=1).jacobians)
    effect = np.linalg.norm(slope * column(free, "typical"), axis=0)
    seen = tuple(p.name for p, size in zip(free, effect, strict=True) if size > noise)
    if not seen:
        found = f"no motion above the noise of {1e3 * noise:.2g} mrad"
        raise InputError(fitted[0].file, "", found, "a joint that moves visibly")
    return seen, tuple(p.name for p in free if p.name not in seen)


def _with_inertia(fitted: list[Trace], best: Fit) -> Fit:
    """Fit again with inertia free, from the fit that held it and from one with more of it."""
    more = best.row.copy()
    more[:3] *= 1.3, 1.3, 0.3
    more[INERTIA_LEFT_OUT] = 0.3 * best.inertia
    fits = [
        fit(fitted, row, (*gains(row, best.inertia), inertia_left_out(row, best.inertia)))
        for row in (best.row, more)
    ]
    return min(fits, key=lambda one: one.loss(best.scale_rad))


def _figures(
    best: Fit, unseen: tuple[Array, ...], fitted: list[Trace], noise: float
) -> dict[str, float | None]:
    errors = [e for e in best.residuals if e.size]
    period = float(np.median(np.diff(fitted[0].t)))
    everything = np.concatenate(errors)
    return {
        "train": rms(errors),
        "heldout": rms(unseen) if unseen else None,
        "noise": noise,
        "whiteness": whiteness(errors),
        "correlation_time_s": float(np.mean([correlation_samples(e) for e in errors])) * period,
        "robust_outliers": float(np.mean(np.abs(everything) > 4 * best.scale_rad)),
    }


def _joint_model(
    best: Fit,
    ends: dict[str, tuple[float, float]],
    spread: Uncertainty,
    load: Load,
    notes: tuple[str, ...],
    motor: MotorFit | None,
) -> JointModel:
    names = best.names
    kp, kd, latency = (float(x) for x in best.row[:3])
    known = load is not PER_INERTIA
    fitted: dict[str, dict[str, float]] = {}
    for name, value in zip(names, best.values, strict=True):
        effect, _, parameter = name.rpartition(".")
        if effect:
            fitted.setdefault(effect, {})[parameter] = float(value)
    fitted.pop("motor", None)
    return JointModel(
        kp_Nm_per_rad=kp,
        kd_Nms_per_rad=kd,
        latency_s=latency,
        inertia_kgm2=load.inertia_kgm2,
        per_inertia=not known,
        law="pd" if motor is None else "motor",
        motor={} if motor is None else motor.values,
        load=load if known else None,
        interval=ends,
        correlation={
            f"{names[i]}, {names[j]}": float(spread.correlation[i, j])
            for i in range(len(names))
            for j in range(i + 1, len(names))
        },
        effects=tuple(FittedEffect(*entry) for entry in fitted.items()),
        notes=notes,
    )
