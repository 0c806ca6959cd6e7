"""ROS 1 and ROS 2 bags: joint states and the set-points sent to the joints."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.importers.missing import import_warnings
from sim2real.importers.ros_messages import (
    COMMAND_TYPES,
    STATE_TYPES,
    measured,
    read_messages,
    set_points,
)
from sim2real.importers.ros_series import (
    Series,
    Stream,
    Times,
    angle_series,
    command_topics,
    joint_names,
    joint_series,
    streams,
)
from sim2real.importers.ros_sources import check_sources
from sim2real.recording import Recording

OPTIONAL = {"velocity": "velocity_rad_s", "effort": "load"}
SOURCE = (
    "ROS bag; licence not stated in it. Set-points are at the times at which they were sent, in "
    "separate rows without measured values. The column load is the driver's effort. Loads are "
    "unknown."
)


def read_bag(
    path: str | os.PathLike[str],
    *,
    state_topic: str,
    command_topic: str | Sequence[str] | Mapping[str, str],
    joints: Sequence[str] | None = None,
) -> Recording:
    """Read the joint states and commands of a bag as a recording with unknown loads.

    There is a row for each state and each command, so that a set-point has the time at which it
    was sent. A row with only a command has no measured values; every row has the last set-point of
    each joint. The first row is that in which the last joint gets its first set-point: earlier
    states have no command and are omitted, and counted in the metadata. The last row is the last
    state. Joints that a state does not name are missing samples.

    See `ros_series.streams` for the times, and `ros_messages.set_points` for the set-point of a
    trajectory.

    Args:
        path: A ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.
        state_topic: Topic of ``JointState`` messages, or of a controller's state
            (``JointTrajectoryControllerState``).
        command_topic: Topic of ``JointState``, ``JointTrajectory``,
            ``JointTrajectoryControllerState`` (its reference) or ``Float64MultiArray`` messages
            (an array is in the order of ``joints``); or a topic for each joint, of ``Float64``
            for example, in the order of ``joints`` or by joint name.
        joints: The J joints to read; default: those named in the first command.

    Returns:
        A ``servo`` recording of T rows, ``t`` from 0.

    Raises:
        InputError: If the bag, a topic, a message or a joint is invalid, or two sources write one
            topic.
    """
    topics = command_topics(path, command_topic, joints)
    if state_topic in topics:
        raise InputError(path, state_topic, "one topic for states and commands", "two topics")
    allowed_types = dict.fromkeys(topics, COMMAND_TYPES) | {state_topic: STATE_TYPES}
    bag = streams(path, read_messages(path, allowed_types))
    names = joint_names(joints, topics, bag, state_topic)
    state = bag[state_topic]
    position = angle_series(state, names, partial(measured, field="position"))
    warnings = check_sources(state, position, commands=False)
    command: dict[str, Series] = {}
    for topic, topic_joints in topics.items():
        topic_names = topic_joints or names
        sent = angle_series(bag[topic], topic_names, partial(set_points, joints=topic_names))
        warnings += check_sources(bag[topic], sent, commands=True)
        command |= sent
    rows = _rows(state, position, command)
    columns = {}
    for field, column in OPTIONAL.items():
        for name, read in joint_series(state, names, partial(measured, field=field)).items():
            if read[1].any():  # drivers write 0 for quantities that they do not measure
                columns[f"{name}.{column}"] = _sampled(rows, read)
    return Recording(
        name=Path(path).stem,
        kind="servo",
        joints=names,
        t=(rows - rows[0]) / 1e9,
        command=np.stack([_held(rows, command[name]) for name in names], axis=1),
        position=np.stack([_sampled(rows, position[name]) for name in names], axis=1),
        source=SOURCE,
        columns=columns,
        metadata={
            "original_file": Path(path).name,
            "state_topic": state_topic,
            "command_topics": list(topics),
            "clock": {topic: stream.clock for topic, stream in bag.items()},
            "clock_at_start_s": float(rows[0] / 1e9),
            "states_before_first_command": int((state.t < rows[0]).sum()),
            **import_warnings(warnings + _not_read(topics, bag, names)),
        },
    )


def _not_read(
    topics: Mapping[str, Sequence[str]], bag: Mapping[str, Stream], names: Sequence[str]
) -> list[str]:
    """Sentences on joints with set-points that the recording lacks."""
    sent = {
        joint for topic in topics for message in bag[topic].messages for joint in message.joints
    }
    rest = sorted(sent - set(names))
    return [f"Set-points of {', '.join(rest)} are not read: --joints selects."] if rest else []


def _rows(state: Stream, position: Mapping[str, Series], command: Mapping[str, Series]) -> Times:
    """Times in ns, shape (T,), of the states and commands that the recording has rows for."""
    start = max(t[0] for t, _ in command.values())
    for joint, (t, _) in position.items():
        if t[-1] <= start:
            found = f"no position of {joint} after the first set-points"
            raise InputError(state.file, state.topic, found, "states while commands are sent")
    stop = max(t[-1] for t, _ in position.values())
    rows: Times = np.unique(np.concatenate([t for t, _ in (*position.values(), *command.values())]))
    selected: Times = rows[(rows >= start) & (rows <= stop)]
    return selected


def _held(rows: Times, read: Series) -> Array:
    """The last value at or before each row, shape (T,)."""
    t, values = read
    return values[np.searchsorted(t, rows, side="right") - 1]


def _sampled(rows: Times, read: Series) -> Array:
    """The values at their rows and NaN elsewhere, shape (T,)."""
    t, values = read
    present = np.isin(t, rows)
    sampled = np.full(rows.size, np.nan)
    sampled[np.searchsorted(rows, t[present])] = values[present]
    return sampled
