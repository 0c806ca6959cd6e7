"""Swims for viewers: as recorded, and as simulated before and after a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.inference.swims import Swim, SwimSimulator
from sim2real.arrays import Array
from sim2real.diagnose.result import Diagnosis
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.viewers.scenes import POSE, recorded
from sim2real.viewers.signal_group import Scene


def swims_scene(
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    swims: Sequence[Swim],
    simulate: SwimSimulator | None,
    robot: Robot,
) -> Scene:
    """The recordings, and the swims of the plain and of the enriched model from the same start.

    Args:
        diagnosis: The diagnosis.
        recordings: Its recordings.
        swims: The same recordings, prepared for the simulator.
        simulate: The simulator; only the recordings are shown where None.
        robot: The robot.
    """
    scene = sum((recorded(recording, robot) for recording in recordings), start=Scene())
    if simulate is None or diagnosis.baseline is None:
        return scene
    models = {"plain": diagnosis.baseline, "enriched": diagnosis.model}
    for recording, swim in zip(recordings, swims, strict=True):
        tracks = simulate(list(models.values()), swim)
        for name, track in zip(models, tracks, strict=True):
            scene += recorded(_as_recording(recording, swim, track, robot), robot, name)
    return scene


def _as_recording(recording: Recording, swim: Swim, track: Array, robot: Robot) -> Recording:
    """A simulated track (T, 3 + J) at the times of its recording."""
    since_start = recording.t - recording.t[0]
    values = np.column_stack([np.interp(since_start, swim.t, column) for column in track.T])
    names = [joint.name for joint in robot.joints]
    position = np.full_like(recording.position, np.nan)
    position[:, [recording.joints.index(name) for name in names]] = values[:, 3:]
    columns = dict(zip(POSE, values[:, :3].T, strict=True))
    return replace(recording, position=position, columns=columns)
