"""One robot to diagnose, and its joints made ready for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.clock import dropped_rows
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import StatedSet, stated_sets
from sim2real.errors import InputError
from sim2real.identification.motor_prior import largest_rotor
from sim2real.identification.servo_problem import Set
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Recording
from sim2real.robot import Robot, Servo
from sim2real.servo.trace import Trace, check_runs, sensor_noise, traces

UNMODELLED_INERTIA = "unmodelled_inertia"
"""The effect that stands for the rotor of a servo whose model states none."""


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
        data = traces(case.recordings, joint.name)
        if not data:
            continue
        check_runs(data, joint.name)
        joints.append(
            JointCase(
                joint.name,
                data,
                sensor_noise(data),
                coarse_step(data, joint.servo.position_step_rad),
                model=case.model.joints.get(joint.name) if case.model else None,
                references=traces(case.references, joint.name),
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


def coarse_step(traces: Sequence[Trace], stated_rad: float) -> float | None:
    """The step in rad on which all angles lie, where it is well above the stated one, or None."""
    steps = [trace.quantization_step() for trace in traces]
    coarse = min(steps) > DECISION.coarse_step_ratio * stated_rad
    return min(steps) if coarse and max(steps) <= 1.1 * min(steps) else None
