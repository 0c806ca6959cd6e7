"""Noise of what the robot is told of itself at every step: joint angles, position, direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.noise import difference_noise, noise_floor
from sim2real.ranges.entry import Range, normal
from sim2real.ranges.episodes import labelled, listed
from sim2real.recording import Recording

Array = NDArray[np.float64]

_FEWEST = 60
"""Samples below which a recording says nothing of noise."""
_METHOD = "difference-based noise of each, root mean square"


def joint_noise(recordings: Sequence[Recording], joint: str) -> Range | None:
    """Noise of the measured angle of one joint, quantization included; None where none is seen."""
    found, labels = {}, labelled(recordings)
    for recording in (r for r in recordings if joint in r.joints):
        j = recording.joints.index(joint)
        position = recording.position[:, j]
        if np.isfinite(position).sum() >= _FEWEST:
            found[labels[recording.file]] = noise_floor(
                recording.t, recording.command[:, j], position
            )
    if not found:
        return None
    source = f"{listed(found)}: noise floor of each, root mean square"
    return _step(f"{joint}.position_noise_rad", "rad", list(found.values()), source)


def camera_noise(recordings: Sequence[Recording]) -> list[Range]:
    """Noise of position (x and y alike) and direction as the camera gives them.

    From differences of high order, which motion hardly touches: what it finds is noise that is
    independent from frame to frame. A frame that is repeated counts once.
    """
    place: dict[str, list[float]] = {}
    heading: dict[str, list[float]] = {}
    labels = labelled(recordings)
    for recording in (r for r in recordings if "body.x_m" in r.columns):
        label = labels[recording.file]
        t, x, y, yaw = _frames(recording)
        if t.size >= _FEWEST:
            place[label] = [difference_noise(t, x), difference_noise(t, y)]
        seen = np.isfinite(yaw)
        if seen.sum() >= _FEWEST:
            heading[label] = [difference_noise(t[seen], np.unwrap(yaw[seen]))]
    out = []
    for name, unit, found in (
        ("body.position_noise_m", "m", place),
        ("body.yaw_noise_rad", "rad", heading),
    ):
        if found:
            values = [value for pair in found.values() for value in pair]
            out.append(_step(name, unit, values, f"{listed(found)}: {_METHOD}"))
    return out


def _frames(recording: Recording) -> tuple[Array, Array, Array, Array]:
    """Times, x, y and yaw of the frames in which the robot was seen, repeated ones once."""
    none = np.full(recording.t.size, np.nan)
    x, y, yaw = (recording.columns.get(f"body.{n}", none) for n in ("x_m", "y_m", "yaw_rad"))
    seen = np.isfinite(x) & np.isfinite(y)
    t, x, y, yaw = (values[seen] for values in (recording.t, x, y, yaw))
    new = np.ones(t.size, dtype=bool)
    new[1:] = (np.diff(x) != 0) | (np.diff(y) != 0)
    return t[new], x[new], y[new], yaw[new]


def _step(name: str, unit: str, values: Sequence[float], source: str) -> Range:
    return normal(name, 0.0, float(np.sqrt(np.mean(np.square(values)))), unit, source, "step")
