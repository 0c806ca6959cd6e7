"""``sim2real simulate``: swim a recording's commands."""

from __future__ import annotations

import argparse
from contextlib import nullcontext

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from sim.robot.swimmer import CONTROL_S, State, Swimmer
from sim.view.render import check_picture, picture, save_picture
from sim.view.video import FRAMES_PER_S, Video, check_video
from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import check_writable, write_json
from sim2real.recording import Commands, Recording, read_commands, write_recording
from sim2real.robot import Robot, read_robot

Array = NDArray[np.float64]

_EVERY = round(1 / CONTROL_S / FRAMES_PER_S)
"""Control periods from one frame of a video to the next: it plays at the speed of life."""


def run(options: argparse.Namespace) -> int:
    """Swim, and write what a camera and the servos would have seen, as a pool recording."""
    check_writable(options.out)
    if options.plot:
        check_picture(options.plot)
    if options.video:
        check_video(options.video)
    others = (options.commands, options.model, options.robot, options.plot, options.video)
    if options.out.resolve() in {other.resolve() for other in others if other}:
        raise InputError(options.out, "--out", "a file that is named twice", "one of its own")
    robot, model = read_robot(options.robot), read_model(options.model)
    commands = read_commands(options.commands)
    t, command = every_period(commands, robot, str(options.commands))
    swimmer = Swimmer(
        robot,
        model,
        device=options.device,
        cell_m=options.cell_m,
        dimensions=options.dimensions,
        walls=options.walls,
        threads=2,
    )
    states = [swimmer.state()]
    with Video(options.video) if options.video else nullcontext() as video:
        for sent in tqdm(command[:-1], desc="simulate", unit="step", disable=None):
            swimmer.step(sent)
            states.append(swimmer.state())
            if states[-1].stopped[0] >= 0:
                return _stopped(options, swimmer, states)
            if video and swimmer.step_count % _EVERY == 0:
                video.add(picture(swimmer, width=video.width))
    if options.plot:
        print(f"{save_picture(picture(swimmer), options.plot)}: the water at the end")
    write_recording(_recording(options, robot, t, command, states), options.out)
    size = f"{swimmer.units.cell_m:g} m cells, {options.dimensions} dimensions"
    print(f"{options.out}: {t.size} rows at {1 / CONTROL_S:.0f} Hz, {size}")
    return 0


def every_period(commands: Commands, robot: Robot, where: str) -> tuple[Array, Array]:
    """Times and set-points of every control period: each holds until the next was sent.

    Raises:
        InputError: If a joint of the robot has no set-points, or one is missing in between.
    """
    t = np.arange(commands.t[0], commands.t[-1] + CONTROL_S / 2, CONTROL_S)
    row = np.searchsorted(commands.t, t + 1e-9, side="right") - 1
    columns = []
    for joint in robot.joints:
        if joint.name not in commands.by_joint:
            known = ", ".join(commands.by_joint)
            raise InputError(where, f"{joint.name}.command_rad", f"set-points of {known}", "it too")
        sent = commands.by_joint[joint.name][row]
        if not np.all(np.isfinite(sent)):
            line = int(row[np.flatnonzero(~np.isfinite(sent))[0]]) + 2
            field = f"row {line}, {joint.name}.command_rad"
            raise InputError(
                where, field, "no number", "a set-point, as the robot swims to the end"
            )
        columns.append(sent)
    return t, np.stack(columns, axis=1)


def _recording(
    options: argparse.Namespace, robot: Robot, t: Array, command: Array, states: list[State]
) -> Recording:
    pose = np.array([state.pose[0] for state in states])
    return Recording(
        name=options.out.stem,
        kind="pool",
        joints=tuple(joint.name for joint in robot.joints),
        t=t,
        command=command,
        position=np.array([state.measured[0] for state in states]),
        medium="water",
        source=f"Simulated, not measured: {options.model.name} on {options.commands.name}.",
        columns={"body.x_m": pose[:, 0], "body.y_m": pose[:, 1], "body.yaw_rad": pose[:, 2]},
    )


def _stopped(options: argparse.Namespace, swimmer: Swimmer, states: list[State]) -> int:
    """Say where the simulation broke down, and keep the states that led there."""
    last = states[-1]
    cell = int(last.stopped[0])
    nx, ny, _ = swimmer.tank.size
    at = [cell % nx, cell // nx % ny, cell // (nx * ny)]
    kept = options.out.with_suffix(".stopped.json")
    write_json(
        kept,
        {
            "time_s": float(last.time[0]),
            "step": round(float(last.time[0]) / swimmer.units.step_s),
            "cell": at,
            "pose": [state.pose[0].tolist() for state in states[-16:]],
            "joint": [state.joint[0].tolist() for state in states[-16:]],
        },
    )
    where = f"after {last.time[0]:.3f} s at cell {at}"
    print(f"sim2real simulate: the water became supersonic {where}; last states in {kept}")
    return 1
