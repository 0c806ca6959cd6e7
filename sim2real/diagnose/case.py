"""One robot to diagnose, and its joints made ready for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.baseline import SATURATION, with_effects
from sim2real.errors import InputError
from sim2real.identification.servo_problem import (
    Fits,
    Hypothesis,
    Set,
    minimise,
    plain_servos,
)
from sim2real.identification.torque_speed_line import on_its_line
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.noise import quantization_step
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot, Servo
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS, LINE, stated
from sim2real.servo.trace import Trace, check_runs, sensor_noise, traces

_LINE = [COLUMNS.index(name) for name in LINE]
_FLAT = [COLUMNS.index(f"{SATURATION}.{name}") for name in ("limit_Nm", "free_damping")]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """One robot to diagnose.

    Attributes:
        recordings: What is to be explained.
        robot: The robot.
        model: A model to start from; its effects stay part of the plain servo.
        references: Recordings of the same robot from before. With these the question is what has
            changed since, not what a servo lacks.
    """

    recordings: Sequence[Recording]
    robot: Robot
    model: Model | None = None
    references: Sequence[Recording] = ()


@dataclass(frozen=True)
class JointCase:
    """A joint with its recordings.

    Attributes:
        name: Its name.
        traces: Its recordings.
        noise: Standard deviation of its sensor's noise, rad.
        step_rad: Step of its sensor where that is coarser than stated, or None.
        given: The model of it to start from, or None.
        before: Its references.
        servo: Its data sheet, or None.
    """

    name: str
    traces: list[Trace]
    noise: float
    step_rad: float | None
    given: JointModel | None = None
    before: Sequence[Trace] = ()
    servo: Servo | None = None

    @property
    def stall_Nm(self) -> float | None:
        """Torque that its data sheet states; None where its load is unknown."""
        if self.servo is None or self.traces[0].load is PER_INERTIA:
            return None
        return self.servo.max_torque_Nm

    @property
    def base(self) -> Set:
        """Effects that its given model has."""
        return frozenset(e.effect for e in self.given.effects) if self.given else frozenset()


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
        data = traces(case.recordings, joint.name)
        if data:
            check_runs(data, joint.name)
            noise = sensor_noise(data)
            step = coarse_step(data, joint.servo.position_step_rad)
            model = case.model.joints.get(joint.name) if case.model else None
            before = traces(case.references, joint.name)
            joints.append(JointCase(joint.name, data, noise, step, model, before, joint.servo))
    if not joints:
        file = case.recordings[0].file
        raise InputError(file, "", "no motion", "commands and angles that change")
    return joints


def on_their_lines(case: Case, rng: np.random.Generator) -> Case:
    """The case, each joint that reaches the line of its data sheet with a model that has it.

    One with references keeps what it knows, and a joint a given model that is no plain servo.
    """
    known = dict(case.model.joints) if case.model else {}
    lines = {}
    for joint in case.robot.joints if not case.references else ():
        model, data = known.get(joint.name), traces(case.recordings, joint.name)
        if not data or (model is not None and (model.law != "pd" or model.effects)):
            continue
        line = on_its_line(data, joint.servo, rng, room=1 / DECISION.data_sheet_share)
        # What changes the error by less, nobody would miss.
        if line is not None and line[1] < 1 - DECISION.negligible:
            lines[joint.name] = line[0]
    if not lines:
        return case
    return replace(case, model=replace(case.model or Model(joints={}), joints=known | lines))


def limits_beside(
    batch: Batch, joints: Sequence[JointCase], best: Sequence[Hypothesis]
) -> dict[int, JointModel]:
    """Plain models with their motor's limit, of joints that reach it beside what explains them.

    The limit is a line of torque and speed, or flat: the data sheet's torque at any speed. Anything
    large that is missing hides it from a fit of the plain servo. The likelier of the two is chosen.

    Args:
        batch: The recordings, joint by joint.
        joints: The joints of the batch.
        best: What explains each best at first sight.
    """
    models = {}
    for j, (joint, servo) in enumerate(zip(joints, best, strict=True)):
        row = servo.fit.servos.theta[0].copy()
        if joint.before or joint.base or joint.stall_Nm is None or row[_LINE].any():
            continue
        assert joint.servo is not None
        least = DECISION.data_sheet_share * joint.stall_Nm
        # A limit at the data sheet's is the motor's by another name.
        at_sheet = row[_FLAT[0]] > least
        others: Set = servo.members - {SATURATION} if at_sheet else servo.members
        line, flat = row.copy(), row.copy()
        line[_FLAT] = 0.0 if at_sheet else line[_FLAT]
        line[_LINE] = joint.stall_Nm, joint.servo.no_load_speed_rad_s
        if not at_sheet:
            flat[_FLAT] = joint.stall_Nm, 1.0
        fits = [_fitted(batch, j, others, line)]
        if SATURATION not in others:
            fits.append(_fitted(batch, j, others | {SATURATION}, flat))
        gains = [float(fit.loglikelihood[0] - servo.fit.loglikelihood[0]) for fit in fits]
        k = int(np.argmax(gains))
        if gains[k] <= (-1.0 if at_sheet else DECISION.decisive_gain):
            continue
        theta = fits[k].servos.theta[0]
        if k == 0 or theta[_FLAT[0]] > least:
            flat_limit = dict(zip(("limit_Nm", "free_damping"), theta[_FLAT].tolist(), strict=True))
            effects = [FittedEffect(SATURATION, flat_limit)] if k else []
            models[j] = stated(theta, joint.traces[0].load, effects)
    return models


def _fitted(batch: Batch, j: int, members: Set, row: Array) -> Fits:
    """The fit of joint ``j`` with these effects, from a row (P,)."""
    inertia = batch.load[batch.first_signal[j], :1]
    plain = plain_servos(np.array([j]), row[None], inertia, batch.period, free_line=True)
    start = with_effects(plain, members, row, float(row[0]), float(inertia[0]))
    return minimise(batch, start, iterations=15)


def coarse_step(traces: Sequence[Trace], stated_rad: float) -> float | None:
    """The step on which all of a joint's angles lie, where it is well above the stated one, rad.

    Args:
        traces: The joint's recordings.
        stated_rad: ``position_step_rad`` of the data sheet.
    """
    steps = [quantization_step(np.where(t.used, t.position, np.nan)) for t in traces]
    step = min(steps)
    coarse = step > DECISION.coarse_step_ratio * stated_rad and max(steps) <= 1.1 * step
    return step if coarse else None
