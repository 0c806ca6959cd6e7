"""ROS 1 and ROS 2 bags: joint states and the set-points sent to the joints."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from sim2real.errors import InputError
from sim2real.importers.options import import_warnings
from sim2real.importers.ros_messages import (
    COMMAND_TYPES,
    STATE_TYPES,
    Stream,
    joint_series,
    measured,
    read_messages,
    set_points,
    streams,
)
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
    command_topic: str | Sequence[str],
    joints: Sequence[str] | None = None,
) -> Recording:
    """Read the joint states and commands of a bag as a ``servo`` recording with unknown loads.

    There is a row for each state and each command, so that a set-point has the time at which it was
    sent. A row with only a command has no measured values; every row has the last set-point of each
    joint. The first row is that in which the last joint gets its first set-point: earlier states
    are omitted, and counted in the metadata. The last row is the last state. Joints that a state
    does not name are missing samples.

    The bag is a ``.bag``, ``.db3`` or ``.mcap`` file or a folder; topics are of ``STATE_TYPES`` and
    ``COMMAND_TYPES``, that of the commands one for all joints or one for each. Joints are by
    default those named in the first command. ``InputError`` if the bag, a topic, a message or a
    joint is invalid, or two sources write the states.
    """
    listed = [command_topic] if isinstance(command_topic, str) else list(command_topic)
    if len(listed) != 1 and len(joints or ()) != len(listed):
        found = f"{len(joints or ())} joints and {len(listed)} command topics for them"
        raise InputError(path, "joints", found, "one topic for all or one for each joint")
    if state_topic in listed:
        raise InputError(path, state_topic, "one topic for states and commands", "two topics")
    allowed_types = dict.fromkeys(listed, COMMAND_TYPES) | {state_topic: STATE_TYPES}
    bag = streams(path, read_messages(path, allowed_types))
    state = bag[state_topic]
    names = _joint_names(joints, bag[listed[0]], state)
    position = joint_series(state, names, partial(measured, field="position"))
    warnings = check_source(state, position)
    command: dict[str, pd.Series[float]] = {}
    for topic in dict.fromkeys(listed):
        own = names
        if len(listed) > 1:
            own = tuple(name for name, one in zip(names, listed, strict=True) if one == topic)
        command |= joint_series(bag[topic], own, partial(set_points, joints=own))
    start = max(values.index[0] for values in command.values())
    for joint, values in position.items():
        if values.index[-1] <= start:
            found = f"no position of {joint} after the first set-points"
            raise InputError(path, state_topic, found, "states while commands are sent")
    others = {
        f"{joint}.{column}": values
        for field, column in OPTIONAL.items()
        for joint, values in joint_series(
            state, names, partial(measured, field=field), angles=False
        ).items()
        if values.any()  # drivers write 0 for quantities that they do not measure
    }
    angles, sent = _frame(position)[list(names)], _frame(command)[list(names)]
    rows = angles.index.union(sent.index)
    sent = sent.reindex(rows).ffill()
    stop = max(values.index[-1] for values in position.values())
    rows = rows[sent.notna().all(axis=1) & (rows <= stop)]
    other_names = {joint for topic in listed for m in bag[topic].messages for joint in m.joints}
    if rest := sorted(other_names - set(names)):
        warnings.append(f"Set-points of {', '.join(rest)} are not read: --joints selects.")
    return Recording(
        name=Path(path).stem,
        kind="servo",
        joints=names,
        t=(rows.to_numpy() - rows[0]) / 1e9,
        command=sent.loc[rows].to_numpy(),
        position=angles.reindex(rows).to_numpy(),
        source=SOURCE,
        columns={str(name): x.to_numpy() for name, x in _frame(others).reindex(rows).items()},
        metadata={
            "original_file": Path(path).name,
            "state_topic": state_topic,
            "command_topics": list(dict.fromkeys(listed)),
            "clock": {topic: stream.clock for topic, stream in bag.items()},
            "clock_at_start_s": float(rows[0] / 1e9),
            "states_before_first_command": int((state.t < rows[0]).sum()),
            **import_warnings(warnings),
        },
    )


def _frame(series: Mapping[str, pd.Series[float]]) -> pd.DataFrame:
    """One column for each joint, with the last of several values of one time."""
    return pd.DataFrame({n: x[~x.index.duplicated(keep="last")] for n, x in series.items()})


def _joint_names(joints: Sequence[str] | None, first: Stream, state: Stream) -> tuple[str, ...]:
    """The requested joints, else those named in the first command, else the only one of a state."""
    state_joints = state.messages[0].joints
    names = tuple(joints or first.messages[0].joints)
    if not names and len(state_joints) == 1:
        return state_joints
    if not names:
        expected = f"names in the order of the set-points on {first.topic}, of "
        raise InputError(first.file, "joints", "none named", expected + ", ".join(state_joints))
    if len(set(names)) != len(names):
        raise InputError(first.file, "joints", ", ".join(names), "each name once")
    return names


def check_source(
    stream: Stream,
    series: Mapping[str, pd.Series[float]],
    *,
    fewest: int = 5,
    warned: float = 0.01,
    most_warned: float = 0.1,
    least_rad: float = 0.02,
) -> list[str]:
    """Warnings of angles that lie apart from those before and after them, which agree.

    They are failed readings, or of a second source of the topic. ``series`` are angles in rad of
    each joint by time in ns, in order of time. Fewer than ``fewest`` are left to chance; there is a
    warning above the share ``warned``, an error above ``most_warned``; they lie apart by at least
    ``least_rad``, several counts of coarse encoders. ``InputError`` if too many angles contradict
    others.
    """
    warnings = []
    for joint, values in series.items():
        t, angles = np.asarray(values.index, np.int64), np.asarray(values, np.float64)
        before, after = np.diff(angles)[:-1], -np.diff(angles)[1:]
        size = np.minimum(np.abs(before), np.abs(after))
        agree = np.abs(angles[2:] - angles[:-2])
        # above noise, and common motion
        least = max(8 * float(np.quantile(agree, 0.25)), least_rad) if agree.size else 0.0
        apart = np.flatnonzero((before * after > 0) & (size > np.maximum(5 * agree, least)))
        if apart.size < max(fewest, warned * angles.size):
            continue
        found = (
            f"{apart.size} of {angles.size} angles of {joint} apart from those before and after "
            f"them (the first {size[apart[0]]:.2g} rad, {(t[apart[0] + 1] - t[0]) / 1e9:.4g} s "
            "after the first message): two publishers, or failed readings"
        )
        if apart.size > most_warned * angles.size:
            expected = (
                f"messages of one source (ros2 topic info --verbose {stream.topic} lists the "
                "publishers): record again with one, or remove the messages of the other"
            )
            raise InputError(stream.file, stream.topic, found, expected)
        warnings.append(f"{stream.topic}: {found}.")
    return warnings
