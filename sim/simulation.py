"""Recorded commands simulated in the fluid or in its reduced-order twin."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from tqdm import tqdm

from sim.inference.swims import FLUID_THREADS, POSES
from sim.robot.live import State
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim.twin.twin import Twin
from sim2real.arrays import Array
from sim2real.display import NotebookDisplay
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.plausible import validate_commands
from sim2real.recording import Recording
from sim2real.report.notebook import result_section
from sim2real.report.page import Section, Table
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

File = str | os.PathLike[str]
_KEPT_STATES = 16
"""Number of states before a breakdown that the error stores."""


class SupersonicFlow(FloatingPointError):
    """The flow became supersonic at this ``time_s``, ``step`` and ``cell``, after ``states``."""

    def __init__(self, name: str, swimmer: Swimmer, states: list[State]) -> None:
        """The breakdown of a swimmer, from the last of its states."""
        cell, (nx, ny, _) = int(states[-1].stopped[0]), swimmer.tank.size
        self.time_s = float(states[-1].time[0])
        self.step = round(self.time_s / swimmer.units.step_s)
        self.cell = [cell % nx, cell // nx % ny, cell // (nx * ny)]
        self.states = states[-_KEPT_STATES:]
        super().__init__(
            f"{name}: the flow became supersonic after {self.time_s:.3f} s at cell {self.cell}"
        )


@dataclass(frozen=True)
class Simulated(NotebookDisplay):
    """Swims of a model."""

    # pool recordings: commands, measured joint angles and the head's pose, every 20 ms
    swims: tuple[Recording, ...]

    def __str__(self) -> str:
        """Duration, path length and displacement of each swim."""
        lines = []
        for swim in self.swims:
            x, y = (swim.columns[name] for name in POSES[:2])
            length = float(np.hypot(np.diff(x), np.diff(y)).sum())
            displacement = float(np.hypot(x[-1] - x[0], y[-1] - y[0]))
            lines.append(
                f"{swim.name}: {swim.duration_s:.2f} s, path of the head {length:.3f} m, "
                f"displacement {displacement:.3f} m"
            )
        return "\n".join(lines)

    def plot(self) -> Figure:
        """The paths of the heads, from above."""
        from sim2real.report.drawing import new_figure

        with new_figure(420, "paths of the heads, from above") as figure:
            axes = figure.subplots()
            for swim in self.swims:
                axes.plot(swim.columns[POSES[0]], swim.columns[POSES[1]], label=swim.name)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel("x, m")
            axes.set_title("y, m")
            axes.legend()
        return figure


@result_section.register
def _simulated(simulated: Simulated) -> Section:
    rows = [line.split(": ", 1) for line in str(simulated).splitlines()]
    return Section("Simulated swims", "", [Table(("recording", "swim"), rows)])


def simulate_recording(
    recording: Recording,
    robot: Robot,
    model: Model,
    *,
    fidelity: Literal["fluid", "twin"],
    device: str,
    plot: File | None = None,
    video: File | None = None,
    **options: Any,  # noqa: ANN401 - of the swimmer
) -> Recording:
    """Simulate the commands of a recording from its first pose; see ``sim.verbs.simulate``."""
    validate_commands(recording, robot)
    t, command = _every_period(recording, robot)
    pose = np.zeros(3)
    for k, name in enumerate(POSES):
        column = recording.columns.get(name, np.zeros(0))
        pose[k] = next(iter(column[np.isfinite(column)]), 0.0)
    if fidelity == "twin":
        track = Twin(robot, model, device=device).swum(command, pose)[0]
    else:
        swimmer = Swimmer(robot, model, device=device, threads=FLUID_THREADS, **options)
        if POSES[0] in recording.columns:
            swimmer.reset(pose=pose)
        track = _swum(swimmer, command, recording.name, video)
        if plot is not None:
            from sim.view.picture import picture, save_picture

            save_picture(picture(swimmer), plot)
    if not np.isfinite(track).all():
        expected = "a robot and a model whose simulation is stable"
        raise InputError(recording.file, "", "a motion that grows without bound", expected)
    return Recording(
        name=recording.name,
        kind="pool",
        joints=tuple(joint.name for joint in robot.joints),
        t=t,
        command=command,
        position=track[:, 3:],
        medium="water",
        source=f"Simulated, not measured: a model on the commands of {recording.name}.",
        columns=dict(zip(POSES, track[:, :3].T, strict=True)),
        metadata={"simulated": True},
    )


def _every_period(recording: Recording, robot: Robot) -> tuple[Array, Array]:
    """Times and set-points of every control period; a set-point holds until the next one."""
    t = np.arange(recording.t[0], recording.t[-1] + CONTROL_S / 2, CONTROL_S)
    row = np.searchsorted(recording.t, t + 1e-9, side="right") - 1
    columns = []
    for joint in robot.joints:
        field = f"{joint.name}.command_rad"
        if joint.name not in recording.joints:
            known = ", ".join(recording.joints)
            raise InputError(recording.file, field, f"set-points of {known}", "its set-points too")
        set_points = recording.command[row, recording.joints.index(joint.name)]
        if not np.all(np.isfinite(set_points)):
            line = int(row[np.flatnonzero(~np.isfinite(set_points))[0]]) + 2
            raise InputError(recording.file, f"row {line}, {field}", "no number", "a set-point")
        columns.append(set_points)
    return t, np.stack(columns, axis=1)


def _swum(swimmer: Swimmer, command: Array, name: str, video: File | None) -> Array:
    """Poses and measured angles at the beginning of each period, (T, 3 + J), filmed if asked."""
    states = [swimmer.state()]
    with ExitStack() as stack:
        if video is not None:
            from sim.view.picture import picture
            from sim.view.video import FRAMES_PER_S, Video

            film = stack.enter_context(Video(video))
            periods = round(1 / CONTROL_S / FRAMES_PER_S)  # the video plays in real time
        for set_points in tqdm(command[:-1], desc="simulate", unit="step", disable=None):
            swimmer.step(set_points)
            states.append(swimmer.state())
            if states[-1].stopped[0] >= 0:
                raise SupersonicFlow(name, swimmer, states)
            if video is not None and swimmer.step_count % periods == 0:
                film.add(picture(swimmer, width=film.width))
    return np.array([np.concatenate([state.pose[0], state.measured[0]]) for state in states])
