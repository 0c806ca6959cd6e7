"""Set a fitted model beside what was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.servo.predict import predict
from sim2real.servo.trace import split, traces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Replay:
    """One joint of one recording and what the model makes of its commands.

    Attributes:
        recording: The recording.
        joint: The joint.
        predicted: Predicted angles in rad, shape (T,).
        held_out: Samples that the fit did not see, shape (T,).
    """

    recording: Recording
    joint: str
    predicted: Array
    held_out: NDArray[np.bool_]


def replay(
    model: Model, recordings: Sequence[Recording], held_out: str | None = None
) -> list[Replay]:
    """Replay every recording of every joint of the model that moves in it.

    Args:
        model: The fitted model.
        recordings: The recordings that it was identified from.
        held_out: As given to ``identify``.
    """
    replays = []
    for joint in model.joints:
        _, scored, _ = split(traces(recordings, joint), held_out)
        unseen = {trace.file: trace.used for trace in scored}
        for recording in (r for r in recordings if joint in r.joints):
            command = recording.command[:, recording.joints.index(joint)]
            angles = predict(model, recording.t, {joint: command}, recording.loads)
            mask = np.zeros(recording.t.size, dtype=bool)
            used = unseen.get(recording.file, mask)
            mask[: used.size] = used
            replays.append(Replay(recording, joint, angles[joint], mask))
    return replays
