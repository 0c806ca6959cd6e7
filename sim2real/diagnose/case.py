"""One robot to diagnose: its joints made ready for it, and what is known of each in the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.check import all_findings, check
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.investigate import Finding
from sim2real.diagnose.search import Hypothesis, Set
from sim2real.diagnose.unmodelled import WANDER
from sim2real.diagnose.wording import fitted_effects
from sim2real.errors import InputError
from sim2real.inference.holdout import rms
from sim2real.model import JointModel, Model
from sim2real.noise import noise_floor, quantization_step
from sim2real.recording import Recording
from sim2real.robot import Robot, match_joints
from sim2real.servo.holdout import Unseen
from sim2real.servo.parameters import joint_row, motor_of
from sim2real.servo.trace import PER_INERTIA, Trace, traces

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

    @property
    def before(self) -> Case:
        """The references as a case of their own."""
        return replace(self, recordings=self.references, references=())


@dataclass(frozen=True)
class Joint:
    """A joint with its recordings.

    Attributes:
        name: Its name.
        traces: Its recordings.
        noise: Standard deviation of its sensor's noise, rad.
        step_rad: Step of its sensor where that is coarser than stated, or None.
    """

    name: str
    traces: list[Trace]
    noise: float
    step_rad: float | None


def prepared(case: Case) -> list[Joint]:
    """The joints of a case that move.

    Raises:
        InputError: If recordings and robot do not agree, or no joint moves.
    """
    for recording in case.recordings:
        match_joints(recording, case.robot)
        if np.isnan(recording.command).all():
            found, expected = "no J.command_rad column", "the set-points that were sent"
            raise InputError(recording.file, "header", found, expected)
    joints = []
    for joint in case.robot.joints:
        given = traces(case.recordings, joint.name)
        if given:
            noise = max(noise_floor(x.t, x.command, x.position) for x in given)
            step = coarse_step(given, joint.servo.position_step_rad)
            joints.append(Joint(joint.name, given, noise, step))
    if not joints:
        recording = case.recordings[0]
        found, expected = "no motion", "commands and angles that change"
        raise InputError(recording.file, "", found, expected)
    return joints


def rows(cases: Sequence[Case], joints: Sequence[Sequence[Joint]]) -> Array | None:
    """Parameter rows of the given models, one a joint, NaN where there is none, shape (J, P)."""
    if all(case.model is None for case in cases):
        return None
    found = []
    for case, some in zip(cases, joints, strict=True):
        for joint in some:
            model = case.model.joints.get(joint.name) if case.model else None
            unknown = np.full_like(joint_row(_NOBODY, None), np.nan)
            found.append(unknown if model is None else joint_row(model, None, joint.name))
    return np.array(found)


_NOBODY = JointModel(1.0, 0.0, 0.0, 1.0)


def bases(cases: Sequence[Case], joints: Sequence[Sequence[Joint]]) -> list[frozenset[str]] | None:
    """Effects of the given models, one set a joint."""
    if all(case.model is None for case in cases):
        return None
    found = []
    for case, some in zip(cases, joints, strict=True):
        for joint in some:
            model = case.model.joints.get(joint.name) if case.model else None
            found.append(frozenset(e.effect for e in model.effects) if model else frozenset())
    return found


def servo(joint: Joint, theta: Array, hypothesis: Hypothesis) -> JointModel:
    """A fitted joint as a model states it.

    Args:
        joint: The joint.
        theta: Its parameters, shape (P,); what it has of a motor included.
        hypothesis: The effects that it has.
    """
    motor = motor_of(theta)
    load = joint.traces[0].load
    kp, kd, latency = (float(x) for x in theta[:3])
    return JointModel(
        kp,
        kd,
        latency,
        inertia_kgm2=load.inertia_kgm2,
        per_inertia=load is PER_INERTIA,
        law="motor" if motor else "pd",
        motor=motor,
        load=None if load is PER_INERTIA else load,
        effects=fitted_effects(hypothesis, joint.step_rad),
    )


def gate(case: Case) -> tuple[str, ...]:
    """What the data gate found, a sentence each."""
    sentences: dict[str, None] = {}
    for recording in case.recordings:
        for sentence in all_findings(check(recording, case.robot)):
            sentences[f"{recording.name}: {sentence}"] = None
    return tuple(sentences)


def coarse_step(traces: Sequence[Trace], stated_rad: float) -> float | None:
    """The step on which all of a joint's angles lie, where it is well above the stated one, rad.

    Args:
        traces: The joint's recordings.
        stated_rad: ``position_step_rad`` of the data sheet.
    """
    steps = [quantization_step(np.where(t.used, t.position, np.nan)) for t in traces]
    found = min(steps)
    if found <= DECISION.coarser * stated_rad or max(steps) > 1.1 * found:
        return None
    return found


@dataclass(frozen=True)
class JointResult:
    """One joint.

    Attributes:
        joint: Its recordings.
        finding: What it is missing.
        rich: The servo with what is named.
        before: Simulated minus measured angles of the plain servo in rad, shape (R, T).
        after: Those of the enriched one.
        least_squares: Parameters of the plain servo as ``identify`` fits them, shape (P,).
        unseen: Errors on held-out data, by the effects that a servo has; empty where nothing can be
            held out.
    """

    joint: Joint
    finding: Finding
    rich: Hypothesis
    before: Array
    after: Array
    least_squares: Array
    unseen: Mapping[Set, Unseen]

    @property
    def name(self) -> str:
        """Of the joint."""
        return self.joint.name

    @property
    def signal(self) -> str:
        """Of the joint's angle."""
        return f"{self.name}.position_rad"

    @property
    def richer(self) -> bool:
        """Whether anything was added to the plain servo."""
        return self.rich.members != self.finding.tried.base

    @property
    def unseen_plain(self) -> Unseen | None:
        """Errors of the plain servo on held-out data."""
        return self.unseen.get(self.finding.tried.base)

    @property
    def error(self) -> float:
        """Of the plain servo on held-out data, or on the fitted where nothing is held out, rad."""
        return self.unseen_plain.rmse if self.unseen_plain else self._train(self.before)

    def fit(self, *, enriched: bool) -> dict[str, float | None]:
        """Errors on fitted and on held-out data, rad."""
        members = self.rich.members if enriched else self.finding.tried.base
        unseen = self.unseen.get(members)
        train = self._train(self.after if enriched else self.before)
        return {"train": train, "heldout": None if unseen is None else unseen.rmse}

    def heldout(self) -> dict[str, float | None]:
        """Errors on held-out data, and the share of the removable that is removed."""
        plain, rich = self.unseen_plain, self.unseen.get(self.rich.members)
        if plain is None or rich is None:
            return {"rmse_before": None, "rmse_after": None, "recoverable_removed": None}
        # A sensor may wander slowly; no model removes that.
        noise = min(self.joint.noise * np.sqrt(1 + WANDER.share**2), plain.rmse)
        removable = plain.rmse - noise
        removed = (plain.rmse - rich.rmse) / removable if removable > 0 else 0.0
        return {
            "rmse_before": plain.rmse,
            "rmse_after": rich.rmse,
            "recoverable_removed": float(np.clip(removed, -1.0, 1.0)),
        }

    def changes(self, effect: str) -> float:
        """Share by which an effect lowers the held-out error beside the others; or infinity.

        Infinity where that cannot be told: of chance and of rounding, which nobody can foretell,
        and where nothing is held out.
        """
        rich = self.unseen.get(self.rich.members)
        without = self.unseen.get(self.rich.members - {effect}, self.unseen_plain)
        if effect not in self.rich.members or rich is None or without is None:
            return float("inf")
        return 1 - rich.rmse / without.rmse

    def _train(self, residual: Array) -> float:
        pairs = zip(residual, self.joint.traces, strict=False)
        return rms([row[: t.t.size][t.used] for row, t in pairs])
