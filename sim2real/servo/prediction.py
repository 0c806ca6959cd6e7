"""Recordings as a fitted model predicts them, with the errors and a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim2real.display import NotebookDisplay, from_report
from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.servo.predict import predict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction(NotebookDisplay):
    """Joint angles that a model predicts from the commands of recordings.

    Attributes:
        recordings: The R recordings.
        angles: Predicted angles in rad of each recording's joints, R arrays of shape (T, J).
    """

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
        """Recording number ``index`` with the predicted instead of the measured angles."""
        return replace(
            self.recordings[index],
            position=self.angles[index],
            source=source,
            columns={},
            path=None,
        )

    def __str__(self) -> str:
        """The error of each joint in each recording."""
        return "\n".join(
            f"{name}, {joint}: {1e3 * error:.2f} mrad" for (name, joint), error in self.rmse.items()
        )

    def plot(self, recording: int = 0, joint: str | None = None) -> Figure:
        """Measured and predicted angles of one joint of one recording."""
        shown = self.recordings[recording]
        name = shown.joints[0] if joint is None else joint
        angles = self.angles[recording][:, shown.joints.index(name)]
        figure: Figure = from_report("fit_plot.fit_figure")(shown, name, angles)
        return figure


def predict_recordings(recordings: Sequence[Recording], model: Model) -> Prediction:
    """Simulate a model from rest on the commands of recordings.

    Raises:
        InputError: If a joint is not in the model.
    """
    angles = []
    for recording in recordings:
        command = {joint: recording.command[:, j] for j, joint in enumerate(recording.joints)}
        predicted = predict(model, recording.t, command, recording.loads, where=recording.file)
        angles.append(np.stack([predicted[joint] for joint in recording.joints], axis=1))
    return Prediction(tuple(recordings), tuple(angles))
