"""Compare a fitted model with recordings."""

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
    """One joint of one recording and the model's prediction for its commands.

    Attributes:
        recording: The recording.
        joint: Name of the joint.
        predicted: Predicted angles in rad, shape (T,).
        held_out: Mask of the samples that the fit did not use, shape (T,).
    """

    recording: Recording
    joint: str
    predicted: Array
    held_out: NDArray[np.bool_]


def replay(
    model: Model, recordings: Sequence[Recording], held_out: str | None = None
) -> list[Replay]:
    """Predict every joint of the model in every recording that contains it.

    Args:
        model: The fitted model.
        recordings: The recordings that the model was identified from.
        held_out: Name of the held-out recording, as passed to ``identify``.
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
