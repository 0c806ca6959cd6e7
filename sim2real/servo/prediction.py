"""Commands and recordings as a fitted model predicts them, from rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.recording import Load, Recording
from sim2real.servo.parameters import in_context, joint_row
from sim2real.servo.trace import at_one_gain, context_of, split, traces

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def predict(
    model: Model,
    t: Array,
    command: Mapping[str, Array],
    loads: Mapping[str, Load] | None = None,
    *,
    measured: Mapping[str, Array] | None = None,
    where: str = "commands",
) -> dict[str, Array]:
    """Measured angles in rad, shape (T,), of each joint that the model predicts.

    The joints of an arm are simulated together; those that the model lacks follow a constant
    command, and those without a command stay at the URDF's zero.

    Args:
        model: The fitted model.
        t: Times in s, shape (T,).
        command: Set-points in rad by joint, each of shape (T,).
        loads: Loads by joint; for other joints, the load in the model.
        measured: Measured angles in rad by joint, each of shape (T,), NaN where missing: a joint
            starts where it is before its set-points change. By default it rests on the first one.
        where: Origin of the commands, for messages.

    Raises:
        InputError: If a joint is not in the model, or its simulation is unstable.
    """
    from sim2real.servo.rollout import rollout

    for joint, sent in command.items():
        at_rest = model.arm is not None and joint in model.arm.names and np.ptp(sent) == 0
        if joint not in model.joints and not at_rest:
            modelled = ", ".join(model.joints)
            raise InputError(where, f"{joint}.command_rad", f"joint {joint}", f"one of {modelled}")
    if model.arm is not None:
        from sim2real.arm.arm_loads import predicted_arm
        from sim2real.arm.description import Multibody

        return predicted_arm(Multibody(model.arm), model.joints, t, command)[1]
    angles = {}
    for joint, sent in command.items():
        origin = f"model, {joint}"
        row = joint_row(model.joints[joint], (loads or {}).get(joint), where=origin)
        angles[joint] = rollout(row[None], t, sent, measured=(measured or {}).get(joint))[0]
        if not np.isfinite(angles[joint][np.isfinite(sent)]).all():
            raise InputError(where, origin, "angles that grow without bound", "a stable servo")
    return angles


@dataclass(frozen=True)
class Prediction(NotebookDisplay):
    """Joint angles in rad, of each recording (T, J), that a model predicts from its commands."""

    recordings: tuple[Recording, ...]
    angles: tuple[Array, ...]

    @property
    def rmse(self) -> dict[tuple[str, str], float]:
        """Root mean square error in rad by recording and joint; NaN where nothing was measured."""
        errors = {}
        for recording, angles in zip(self.recordings, self.angles, strict=True):
            square = (angles - recording.position) ** 2
            for j, joint in enumerate(recording.joints):
                measured = square[np.isfinite(square[:, j]), j]
                mean = float(np.sqrt(measured.mean())) if measured.size else float("nan")
                errors[recording.name, joint] = mean
        return errors

    def recording(self, index: int = 0, *, source: str = "Simulated, not measured.") -> Recording:
        """Recording number ``index`` with the predicted instead of the measured angles.

        Its JSON has the field ``simulated`` and, of the other fields, the context alone.
        """
        commands = self.recordings[index]
        context = {k: v for k, v in commands.metadata.items() if k == "context"}
        return replace(
            commands,
            position=self.angles[index],
            source=source,
            columns={},
            metadata={**context, "simulated": True},
            path=None,
        )

    def plot(self, recording: int = 0, joint: str | None = None) -> Figure:
        """Measured and predicted angles of one joint of one recording."""
        shown = self.recordings[recording]
        name = shown.joints[0] if joint is None else joint
        angles = self.angles[recording][:, shown.joints.index(name)]
        figure: Figure = from_report("series.fit_figure")(shown, name, angles)
        return figure


def predict_recordings(recordings: Sequence[Recording], model: Model) -> Prediction:
    """Simulate a model on the commands of recordings, from where their joints start."""
    predicted = (_predicted(model, recording, recording.commands) for recording in recordings)
    angles = tuple(np.stack(list(each.values()), axis=1) for each in predicted)
    return Prediction(tuple(recordings), angles)


def _predicted(
    model: Model, recording: Recording, command: Mapping[str, Array]
) -> dict[str, Array]:
    """Angles predicted for set-points of a recording, in the context that it states."""
    context = context_of(*at_one_gain([recording], model.firmware_p_gain))
    joints = {name: in_context(joint, **context) for name, joint in model.joints.items()}
    fitted = replace(model, joints=joints)
    measured = dict(zip(recording.joints, recording.position.T, strict=True))
    return predict(
        fitted, recording.t, command, recording.loads, measured=measured, where=recording.file
    )


@dataclass(frozen=True)
class Replay:
    """One joint of one recording and the angles in rad (T,) predicted for its commands.

    ``held_out`` is a mask of the samples on which the model was scored before it was fitted to them
    as well, shape (T,).
    """

    recording: Recording
    joint: str
    predicted: Array
    held_out: Mask


def replay(
    model: Model, recordings: Sequence[Recording], held_out: str | None = None
) -> list[Replay]:
    """Predict every joint of a model in every recording that it was identified from.

    ``held_out`` is the name of the held-out recording, as passed to ``identify``.
    """
    modelled = {*model.joints, *(() if model.arm is None else model.arm.names)}
    angles = {}
    for recording in (r for r in recordings if not set(model.joints).isdisjoint(r.joints)):
        commands = {j: x for j, x in recording.commands.items() if j in modelled}
        angles[recording.file] = _predicted(model, recording, commands)
    replays = []
    for joint in model.joints:
        _, scored, _ = split(traces(recordings, joint), held_out)
        unseen = {trace.file: trace.used for trace in scored}
        for recording in (r for r in recordings if joint in r.joints):
            mask = np.zeros(recording.t.size, dtype=bool)
            used = unseen.get(recording.file, mask)
            mask[: used.size] = used
            replays.append(Replay(recording, joint, angles[recording.file][joint], mask))
    return replays
