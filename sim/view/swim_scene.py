"""Swims for viewers: as recorded, and as simulated before and after a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

from sim.inference.coordinates import Swum
from sim.inference.swims import Swim
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
    simulate: Swum | None,
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
            simulated = _as_recording(swim, track, float(recording.t[0]), robot)
            scene += recorded(simulated, robot, name)
    return scene


def _as_recording(swim: Swim, track: Array, start_s: float, robot: Robot) -> Recording:
    """A simulated track (T, 3 + J) of a swim as a recording, under a name of its own."""
    return Recording(
        name=f"{swim.name}, simulated",
        kind="pool",
        joints=tuple(joint.name for joint in robot.joints),
        t=start_s + swim.t,
        command=swim.command,
        position=track[:, 3:],
        medium="water",
        columns=dict(zip(POSE, track[:, :3].T, strict=True)),
    )
