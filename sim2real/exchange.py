"""The verbs for files of other tools: ``import_log`` reads logs, ``export`` writes for simulators.

Like ``sim2real.verbs``, this module imports no large libraries.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sim2real.errors import InputError, check_choice
from sim2real.verbs import model_of, recordings_of, robot_of

if TYPE_CHECKING:
    from sim2real.exporters.actuator import Export
    from sim2real.model import Model
    from sim2real.ranges.entry import Ranges
    from sim2real.ranges.gather import Gathered
    from sim2real.recording import Recording
    from sim2real.robot import Robot
    from sim2real.verbs import File, Recorded


def import_log(
    source: File,
    out: File | None = None,
    *,
    state_topic: str | None = None,
    command_topic: Sequence[str] | str | None = None,
    joints: Sequence[str] | str | None = None,
    units: Sequence[str] | str | None = None,
    calibration: File | None = None,
    counts_per_turn: int | None = None,
    zero_count: float | None = None,
    episode: int | None = None,
    columns: Sequence[str] | str | None = None,
    time_unit: Literal["s", "ms", "us", "ns"] | None = None,
    inertia: Sequence[str] | str | None = None,
    pendulum: Sequence[str] | str | None = None,
) -> Recording | Model:
    """Convert a log of another tool to a recording, or BAM's parameters of a servo to a model.

    Args:
        source: A BAM log (.json), a ROS 1 or 2 bag, a LeRobot dataset (its folder), a table (.csv,
            .tsv), or BAM's parameters of a servo (.json).
        out: Recording to write (.csv); of parameters: model (.json).
        state_topic: Bag: measured joint states; /joint_states by default.
        command_topic: Bag: commanded positions; once, or once for each joint.
        joints: Bag, dataset: joints, in order.
        units: Dataset, table: unit of the angles: rad, deg, turns, counts, range_m100_100 or
            range_0_100; JOINT=UNIT for one joint, JOINT.command=UNIT or JOINT.position=UNIT for one
            of its columns.
        calibration: Calibration file of LeRobot.
        counts_per_turn: Encoder counts per turn.
        zero_count: Encoder count at angle 0.
        episode: Dataset: number of the episode, from 0.
        columns: Table: names of the columns, t=COLUMN J.command=COLUMN J.position=COLUMN ...; of
            arrays 'qpos[0]'.
        time_unit: Table: unit of t.
        inertia: Load of a joint, J=KGM2: its inertia without the servo's rotor, kg m2.
        pendulum: Load of a joint, J=KG,M: mass that hangs straight down at angle 0, and its
            distance from the shaft.

    Raises:
        InputError: If the log cannot be read, an option that it needs is missing, or one does not
            apply to its kind.
    """
    given = {k: x for k, x in locals().items() if x is not None and k not in ("source", "out")}
    from sim2real.importers.read_log import read_log

    return read_log(Path(source), None if out is None else Path(out), given)


def export(
    source: Model | Ranges | Gathered | File,
    to: str,
    out: File | None = None,
    *,
    robot: Robot | File | None = None,
    recordings: Recorded = (),
    which: Literal["nearest", "effects", "plain"] = "nearest",
    into: File | None = None,
    joint: Sequence[str] | str | None = None,
) -> Export:
    """Write identified servos, or randomization ranges, for another simulator.

    Args:
        source: Identified servos (MODEL.json), or ranges (ranges.json).
        to: Simulator or format: mujoco, mjlab, isaaclab, isaaclab-bam, newton, usd, genesis, urdf,
            casadi or json; of ranges isaaclab, mjlab, newton or mujoco-playground.
        out: File to write; the result has its text.
        robot: The robot of servos, for joint limits and data sheets (robot.toml).
        recordings: Recordings to refit servos to if the simulator lacks an effect of the model, and
            to compare with; the last is held out (default: the model's own predictions).
        which: Export the effects of the servos, plain servos without them, or whichever of both is
            nearer to the recordings.
        into: MJCF of a robot (mujoco); the result is this file with the servos in it, and compares
            its steps with the recordings.
        joint: Hinges of that file that get a servo: the model's joint of that name, or its only
            one.

    Returns:
        The text, what it does not express, and the errors of what was refitted.

    Raises:
        InputError: If there is no such simulator, or recordings, robot and model do not agree.
    """
    from sim2real.exporters.ranges import TARGETS as RANGES
    from sim2real.exporters.simulators import TARGETS, export_servos
    from sim2real.output import check_writable, write_whole
    from sim2real.ranges.entry import SCHEMA, Ranges, read_ranges
    from sim2real.ranges.gather import Gathered
    from sim2real.structured import read_json

    if out is not None:
        check_writable(out)
    check_choice("export", "which", which, ("nearest", "effects", "plain"))
    if isinstance(source, str | os.PathLike) and read_json(source).get("schema") == SCHEMA:
        source = read_ranges(source)
    elif isinstance(source, Gathered):
        source = source.ranges
    if isinstance(source, Ranges):
        check_choice("export", "to", to, RANGES)
        if robot is not None or recordings or into is not None or joint:
            raise InputError("export", "", "ranges with options of servos", "ranges alone")
        exported: Export = RANGES[to].write(source)
    else:
        check_choice("export", "to", to, TARGETS)
        description = None if robot is None else robot_of(robot)
        read = recordings_of(recordings) if recordings else []
        names = (joint,) if isinstance(joint, str) else tuple(joint or ())
        if (into is not None or names) and (to != "mujoco" or into is None or not names):
            found = f"to {to}" if to != "mujoco" else "one of both"
            raise InputError("export", "into, joint", found, "both, to mujoco")
        if into is None:
            exported = export_servos(model_of(source), to, read, description, which)
        else:
            from sim2real.exporters.mjcf import into_robot

            files = Path(into), Path(into if out is None else out)
            exported = into_robot(*files, names, model_of(source), read, which)
    if out is not None:
        if Path(out).suffix in exported.beside:
            found = f"the ending {Path(out).suffix}"
            raise InputError(out, "", found, "another one: it is that of a file beside it")
        texts = exported.files(Path(out))
        for path in texts:
            check_writable(path)
        for path, text in texts.items():
            write_whole(path, text)
    return exported
