"""One robot to diagnose, and its joints made ready for it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.clock import dropped_rows
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import StatedSet, stated_sets
from sim2real.errors import InputError
from sim2real.identification.priors import largest_rotor
from sim2real.identification.reading_noise import rest_noise, with_reading_noise
from sim2real.identification.servo_problem import Hypothesis, Set, residual_angles, variants
from sim2real.inference.correlated_noise import SlowErrors
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot, Servo
from sim2real.servo.batch import STEPS_PER_RADIAN, Batch, Problems
from sim2real.servo.parameters import COLUMNS, INERTIA_LEFT_OUT
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, rollout_on
from sim2real.servo.slow_noise import slow_errors
from sim2real.servo.trace import Trace, check_runs, traces

UNMODELLED_INERTIA = "unmodelled_inertia"
"""The effect that stands for the rotor of a servo whose model states none."""
_DRIFT, _LATENCY = COLUMNS.index("clock_drift.s_per_s"), COLUMNS.index("latency_s")


@dataclass(frozen=True)
class Case:
    """One robot to diagnose."""

    recordings: Sequence[Recording]  # what is to be explained
    robot: Robot  # the robot
    model: Model | None = None  # a model to start from; its effects stay part of the plain servo
    # earlier recordings of the robot. With these, only what has changed is named
    references: Sequence[Recording] = ()
    # multiple of the simulation budget of the search for combinations of effects
    effort: float = 1.0
    warnings: tuple[str, ...] = ()  # findings about the recordings by which the result may be wrong


@dataclass(frozen=True)
class JointCase:
    """A joint with its recordings."""

    name: str  # its name
    traces: list[Trace]  # its recordings
    noise: float  # standard deviation of its sensor's noise, rad
    step_rad: float | None  # step of its sensor where that is coarser than stated, or None
    model: JointModel | None = None  # the model of it to start from, or None
    references: Sequence[Trace] = ()  # its earlier recordings, see ``Case``
    servo: Servo | None = None  # its data sheet, or None
    # sets of effects that recordings were designed to distinguish; all are tried
    stated: Sequence[StatedSet] = ()
    effort: float = 1.0  # as of ``Case``
    # whether single rows are missing, so that some set-points have no known time
    lacks_rows: bool = False

    @property
    def stall_Nm(self) -> float | None:
        """Torque that its data sheet states; None where its load is unknown."""
        if self.servo is None or self.traces[0].load is PER_INERTIA:
            return None
        return self.servo.max_torque_Nm

    @property
    def rotor_room_kgm2(self) -> float:
        """Largest inertia of rotor and gears that its data sheet makes likely, beyond the stated.

        0 where its model states it, infinite where the load is unknown.
        """
        if self.traces[0].load is PER_INERTIA:
            return float("inf")
        known = self.model is not None and self.model.motor.get("rotor_inertia_kgm2", 0.0) > 0
        if self.servo is None or known or UNMODELLED_INERTIA in self.base:
            return 0.0
        return largest_rotor(self.servo)

    @property
    def base(self) -> Set:
        """Effects that its model has."""
        return frozenset(e.effect for e in self.model.effects) if self.model else frozenset()


def prepared(case: Case) -> list[JointCase]:
    """The joints of a case that move.

    Raises:
        InputError: If recordings and robot do not agree, or no joint moves.
    """
    for recording in case.recordings:
        if np.isnan(recording.command).all():
            found, expected = "no J.command_rad column", "the set-points that were sent"
            raise InputError(recording.file, "header", found, expected)
    joints = []
    for joint in case.robot.joints:
        data = with_reading_noise(traces(case.recordings, joint.name), slow=not case.references)
        if not data:
            continue
        check_runs(data, joint.name)
        noise = rest_noise(data)
        if data[0].period_s > DECISION.change.slow_sampling_s and not case.references:
            data = [replace(trace, slow=SlowErrors(noise)) for trace in data]
        joints.append(
            JointCase(
                joint.name,
                data,
                noise,
                coarse_step(data, joint.servo.position_step_rad),
                model=case.model.joints.get(joint.name) if case.model else None,
                references=with_reading_noise(traces(case.references, joint.name)),
                servo=joint.servo,
                stated=stated_sets(case.recordings, joint.name),
                effort=case.effort,
                lacks_rows=any(any(dropped_rows(x.t, x.position)) for x in data),
            )
        )
    if not joints:
        file = case.recordings[0].file
        raise InputError(file, "", "no motion", "commands and angles that change")
    return joints


def batch_of(
    joints: Sequence[JointCase], *, period: float | None = None, bounded: bool = True
) -> Batch:
    """The recordings of joints, ready for problems; ``bounded`` as of ``Batch``.

    Where readings come at irregular times, their noise is taken as white: an autoregression would
    take the much larger errors of motion for noise.
    """
    irregular = all(trace.spread is not None for joint in joints for trace in joint.traces)
    slow = all(trace.slow is not None for joint in joints for trace in joint.traces)
    traces = [joint.traces for joint in joints]
    return Batch(traces, bounded=bounded, white=irregular and not slow, period=period)


def coarse_step(traces: Sequence[Trace], stated_rad: float) -> float | None:
    """The step in rad on which all angles lie, where it is well above the stated one, or None."""
    steps = [trace.quantization_step() for trace in traces]
    coarse = min(steps) > DECISION.coarse_step_ratio * stated_rad
    return min(steps) if coarse and max(steps) <= 1.1 * min(steps) else None


def on_one_clock(
    batch: Batch, joints: Sequence[JointCase], best: Sequence[Hypothesis]
) -> list[JointCase]:
    """The joints, their angles as the clock of the set-points would have stamped them.

    Quartz oscillators differ by some 20 ppm, by another amount in each recording, which a good
    sensor detects after half a minute. A larger drift is an effect and is not corrected. ``best``
    is what explains each joint best as yet.
    """
    files = sorted({trace.file for joint in joints for trace in joint.traces})
    information, slope = np.zeros((len(files), len(files))), np.zeros(len(files))
    for joint, servo in zip(joints, best, strict=True):
        place = [files.index(trace.file) for trace in joint.traces]
        known, pull = _known(batch, servo, len(place), _DRIFT)
        pull += known.sum(axis=1) * servo.fit.servos.theta[0, _DRIFT]
        information[np.ix_(place, place)] += known
        slope[place] += pull
    inverse = np.linalg.pinv(information, rcond=1e-10, hermitian=True)
    sd = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    if (np.abs(inverse @ slope) > DECISION.clock_tolerance + 2 * sd).any():
        return list(joints)
    prior = np.eye(len(files)) * (2 / DECISION.clock_tolerance) ** 2
    drift = dict(zip(files, np.linalg.solve(information + prior, slope), strict=True))
    corrected = []
    for joint, servo in zip(joints, best, strict=True):
        moved = []
        for trace in joint.traces:
            angle = simulated(trace, servo.fit.servos.theta[0])
            late = (trace.t - trace.t[0]) * np.gradient(angle, trace.t)
            moved.append(replace(trace, position=trace.position + drift[trace.file] * late))
        corrected.append(replace(joint, traces=moved))
    return corrected


def simulated(trace: Trace, theta: Array) -> Array:
    """Angles in rad of a servo (P,) on the command and load of a recording, shape (T,)."""
    kp, kd, inertia = float(theta[0]), float(theta[1]), trace.load.inertia_kgm2
    inertia += float(theta[INERTIA_LEFT_OUT])
    fastest = max(float(np.sqrt(max(kp, 0.0) / inertia)), 0.5 * kd / inertia, 1e-9)
    step = min(LONGEST_SUBSTEP_S, 1 / (STEPS_PER_RADIAN * fastest))
    return np.asarray(rollout_on(trace, theta[None], substep_s=step)[0])


def with_own_latency(
    batch: Batch, joint: JointCase, servo: Hypothesis, *, sd_s: float = 5e-3
) -> JointCase:
    """The joint, each of its recordings with a latency of its own about a common one.

    Where readings are not taken at regular times, the commands of a recording begin some
    milliseconds early or late, ``sd_s`` a priori. ``servo`` is what explains the joint as yet.
    """
    if all(trace.spread is None for trace in joint.traces):
        return joint
    information, slope = _known(batch, servo, len(joint.traces), _LATENCY)
    later = np.linalg.solve(information + np.eye(len(slope)) / sd_s**2, slope)
    later -= later.mean()
    pairs = zip(joint.traces, later.tolist(), strict=True)
    moved = [replace(x, sample_delay_s=x.sample_delay_s - delay) for x, delay in pairs]
    return replace(joint, traces=moved)


def with_slow_errors(joint: JointCase, servo: Hypothesis) -> JointCase:
    """The joint with the slow errors that the law of a servo leaves, where reading times jitter."""
    if joint.traces[0].slow is None:
        return joint
    (residual,) = residual_angles(batch_of([joint]), servo.fit.of_joints([0]))
    slow = slow_errors(joint.traces, residual, joint.noise)
    return replace(joint, traces=[replace(trace, slow=slow) for trace in joint.traces])


def _known(
    batch: Batch, best: Hypothesis, recordings: int, column: int, *, step: float = 1e-4
) -> tuple[Array, Array]:
    """Information (R, R) and slope (R,) of a parameter of its own in each recording of a joint.

    Of the log-likelihood, the other parameters at their best.
    """
    servos = best.fit.servos
    own = variants(servos)
    kept = [0, *(1 + np.flatnonzero(servos.columns[0] != column)), 0]
    theta, scale = own.theta[:, kept], own.scale[:, kept]
    theta[0, -1, column] += step
    scale[0, -1] = 1 / step
    problem = Problems(servos.joint, theta, scale)
    gram = batch.evaluate(problem, autoregression=best.fit.autoregression).gram[0]
    gram = gram[:recordings] * float(best.fit.count[0] / best.fit.error2[0])
    shared = gram[:, 1:-1, 1:-1].sum(axis=0)
    across = gram[:, 1:-1, -1].T  # shape (F, R)
    taken = across.T @ np.linalg.pinv(shared, rcond=1e-12, hermitian=True)
    information = np.diag(gram[:, -1, -1]) - taken @ across
    return information, -(gram[:, 0, -1] - taken @ gram[:, 0, 1:-1].sum(axis=0))
