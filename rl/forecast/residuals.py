"""What the model of a swimming robot leaves unexplained, from recorded swims."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.inference.swims import by_twin, simulated, swim_of
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.robot import Robot


def residuals_of(recordings: Sequence[Recording], model: Model, robot: Robot) -> list[Array]:
    """Measured less simulated surge, sway, yaw rate and joint angles of each swim, (T, 3 + J).

    Their variance is reduced by that of the measurement noise; missing samples count as explained.

    Raises:
        InputError: If a recording is no swim of this robot, or the twin diverges on it.
    """
    out = []
    for recording in recordings:
        swim = swim_of(recording, robot)
        residual = swim.signals - simulated(swim, [model], by_twin(robot))[0]
        if not np.isfinite(residual).any():
            raise InputError(recording.file, "", "the twin diverges on it", "a swim it can follow")
        square = np.nanmean(residual**2, axis=0)
        share = 1 - np.divide(np.square(swim.noise), square, np.ones_like(square), where=square > 0)
        out.append(np.nan_to_num(residual) * np.sqrt(np.clip(share, 0.0, 1.0)))
    return out
