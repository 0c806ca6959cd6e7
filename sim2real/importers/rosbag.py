"""ROS 1 and ROS 2 bags: joint states and the set-points sent to the joints (package rosbags)."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.errors import InputError, optional
from sim2real.importers.options import import_warnings
from sim2real.recording import Recording
from sim2real.structured import LARGEST_STREAM_BYTES, check_size

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ARRAY = "std_msgs/msg/Float64MultiArray"
FLOAT = "std_msgs/msg/Float64"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
STATE_TYPES = (JOINT_STATE, CONTROLLER)
COMMAND_TYPES = (JOINT_STATE, TRAJECTORY, CONTROLLER, ARRAY, FLOAT)

LARGEST_DELAY_NS = 10**8  # from stamp to receipt, if both are of the same clock
LARGEST_DISORDER_NS = 10**9  # of stamps of a clock that was not set back

Times = NDArray[np.int64]


@dataclass(frozen=True)
class Message:
    """One message."""

    receive_ns: int  # time at which the recorder received it
    header_ns: int  # the stamp in its header; 0 if there is none
    type: str  # its ROS 2 type name, also for ROS 1
    content: Any

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of its joints; empty for types without names."""
        if self.type == JOINT_STATE:
            return tuple(self.content.name)
        return tuple(self.content.joint_names) if self.type in (TRAJECTORY, CONTROLLER) else ()


@dataclass(frozen=True)
class Stream:
    """The N messages of one topic of a bag, with the times of sampling or sending."""

    file: str | os.PathLike[str]
    topic: str
    messages: Sequence[Message]
    t: Times  # in ns, shape (N,)
    clock: str  # kind of the times


def read_messages(
    path: str | os.PathLike[str], allowed_types: Mapping[str, tuple[str, ...]]
) -> dict[str, list[Message]]:
    """Messages of the given topics in the order received; ``InputError`` if that fails."""
    with optional(str(path)):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    if not Path(path).is_dir():
        check_size(Path(path), LARGEST_STREAM_BYTES)
    messages: dict[str, list[Message]] = {topic: [] for topic in allowed_types}
    try:
        # Older ROS 2 bags do not contain the definitions of their messages.
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST)) as bag:
            recorded = sorted({(c.topic, c.msgtype) for c in bag.connections})
            for topic, allowed in allowed_types.items():
                kinds = [kind for name, kind in recorded if name == topic]
                if not kinds:
                    listed = ", ".join(f"{name} ({kind})" for name, kind in recorded) or "none"
                    expected = f"one of: {listed}"
                    raise InputError(path, topic, "no such topic in the bag", expected)
                if not set(kinds) <= set(allowed):
                    raise InputError(path, topic, ", ".join(kinds), " or ".join(allowed))
            connections = [c for c in bag.connections if c.topic in allowed_types]
            for connection, receive_ns, raw in bag.messages(connections):
                content: Any = bag.deserialize(raw, connection.msgtype)
                stamp = getattr(getattr(content, "header", None), "stamp", None)
                header_ns = stamp.sec * 10**9 + stamp.nanosec if stamp is not None else 0
                message = Message(receive_ns, header_ns, connection.msgtype, content)
                messages[connection.topic].append(message)
    except InputError:
        raise
    except Exception as error:  # errors of damaged bags depend on the storage
        problem = f"no bag that can be read ({error})"
        raise InputError(path, "", problem, "a ROS 1 or ROS 2 bag") from error
    if empty := [topic for topic, received in messages.items() if not received]:
        raise InputError(path, empty[0], "0 messages", "at least one")
    return messages


def streams(
    file: str | os.PathLike[str], messages: Mapping[str, Sequence[Message]]
) -> dict[str, Stream]:
    """The messages of each topic with their times.

    Header stamps if every message of a topic has one, else receive times. If both differ by more
    than the transmission time of a message, they are of different clocks (simulated time, or
    another computer), and receive times are used for all topics. ``InputError`` if a clock was set
    back.
    """
    receive, header = (
        {topic: np.array([getattr(m, name) for m in sent]) for topic, sent in messages.items()}
        for name in ("receive_ns", "header_ns")
    )
    stamped = {topic for topic in messages if header[topic].all()}
    delays = [abs(float(np.median(receive[topic] - header[topic]))) for topic in stamped]
    if stamped != set(messages) and max(delays, default=0) > LARGEST_DELAY_NS:
        stamped = set()
    result = {}
    for topic, sent in messages.items():
        clock = "header stamp" if topic in stamped else "receive time"
        t = (header if topic in stamped else receive)[topic]
        back = np.flatnonzero(np.diff(t) < -LARGEST_DISORDER_NS)
        if back.size:
            k, expected = int(back[0]), "a clock never set back"
            found = f"a time {(t[k] - t[k + 1]) / 1e9:g} s before the previous one"
            if back.size > 1:
                found += f", and {back.size} such times"
                expected += ", or one publisher of the topic, not two with clocks of their own"
            raise InputError(file, f"{topic}, message {k + 1}", found, expected)
        result[topic] = Stream(file, topic, sent, t, clock)
    return result


def joint_series(
    stream: Stream, joints: Sequence[str], field: str = "command"
) -> dict[str, pd.Series[float]]:
    """Values of joints in a stream, each by time in ns in order of time; NaN is omitted.

    ``field`` is that of `joint_values`. Angles are in rad, and every joint must have some.
    ``InputError`` if a message is inconsistent, a value too large, or a joint has no angle.
    """
    angles = field in ("command", "position")
    rows = []
    for k, message in enumerate(stream.messages):
        try:
            read = joint_values(message, field, joints)
        except ValueError as error:
            raise InputError(stream.file, f"{stream.topic}, message {k}", *error.args) from None
        rows.append([read.get(joint, np.nan) for joint in joints])
    table = np.array(rows, dtype=np.float64)
    limit = LARGEST_ANGLE_RAD if angles else sys.float_info.max
    for k, j in np.argwhere(np.abs(table) > limit):
        place = f"{stream.topic}, message {k}, {joints[j]}"
        expected = f"a size of at most {limit:.3g} (for angles: radians, not degrees)"
        raise InputError(stream.file, place, f"{table[k, j]:g}", expected)
    frame = pd.DataFrame(table, stream.t, list(joints)).sort_index(kind="stable")
    series = {joint: frame[joint].dropna() for joint in joints if frame[joint].notna().any()}
    for joint in joints if angles else ():
        if joint not in series:
            available = sorted({name for message in stream.messages for name in message.joints})
            expected = f"one of {', '.join(available)}" if available else "one"
            raise InputError(stream.file, stream.topic, f"no angle of joint {joint}", expected)
    return series


def joint_values(message: Message, field: str, joints: Sequence[str]) -> dict[str, float]:
    """``command``, ``position``, ``velocity`` or ``effort`` by joint name; {} if not measured.

    ``joints`` are the names for an array or a number. Of a trajectory the command is its future
    point (``time_from_start`` above 0, or the only point), sent when the trajectory starts:
    interpolation by the controller is attributed to the servo. With several future points the
    controller computes the set-points: they are the ``reference`` of its state, measured values its
    ``feedback`` (``desired`` and ``actual`` before ROS 2 Humble). ``ValueError`` if names and
    values do not match, or there are several points ahead; arguments: found, expected.
    """
    content, names, sent = message.content, message.joints, field == "command"
    if message.type in (FLOAT, ARRAY):
        names, values = tuple(joints), np.atleast_1d(content.data)
    elif message.type == JOINT_STATE:
        values = getattr(content, "position" if sent else field)
    elif message.type == CONTROLLER:
        now, before = ("reference", "desired") if sent else ("feedback", "actual")
        point = getattr(content, now, None)
        if point is None or not len(point.positions):
            point = getattr(content, before, point)
        plural = {"velocity": "velocities", "effort": "effort"}.get(field, "positions")
        values = getattr(point, plural)
    else:
        times = [(p.time_from_start.sec, p.time_from_start.nanosec) for p in content.points]
        ahead = [p for p, t in zip(content.points, times, strict=True) if t > (0, 0)]
        ahead = ahead or content.points
        if len(ahead) != 1:
            expected = "one in each message (or the topic of the controller's own state)"
            raise ValueError(f"{len(ahead)} trajectory points ahead", expected)
        values = ahead[0].positions
    if not (sent or len(values)):
        return {}
    if len(names) != len(values):
        raise ValueError(f"{len(values)} values of {field}", f"one for each of {', '.join(names)}")
    return {name: float(value) for name, value in zip(names, values, strict=True)}


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
    command_topic: Sequence[str],
    joints: Sequence[str] | None = None,
) -> Recording:
    """Read the joint states and commands of a bag as a ``servo`` recording with unknown loads.

    There is a row for each state and each command, at its own time. A row with only a command has
    no measured values; every row has the last set-point of each joint. Rows begin where the last
    joint gets its first set-point (earlier states are counted in the metadata) and end with the
    last state. Topics are of ``STATE_TYPES`` and ``COMMAND_TYPES``, that of the commands one for
    all joints or one for each; joints are by default those named in the first command.
    ``InputError`` if the bag, a topic, a message or a joint is invalid, or two sources write the
    states.
    """
    listed = list(command_topic)
    if len(listed) != 1 and len(joints or ()) != len(listed):
        found = f"{len(joints or ())} joints and {len(listed)} command topics for them"
        raise InputError(path, "joints", found, "one topic for all or one for each joint")
    if state_topic in listed:
        raise InputError(path, state_topic, "one topic for states and commands", "two topics")
    allowed_types = dict.fromkeys(listed, COMMAND_TYPES) | {state_topic: STATE_TYPES}
    bag = streams(path, read_messages(path, allowed_types))
    state = bag[state_topic]
    names = _joint_names(joints, bag[listed[0]], state)
    position = joint_series(state, names, "position")
    warnings = check_source(state, position)
    command: dict[str, pd.Series[float]] = {}
    sources = listed if len(listed) > 1 else listed * len(names)
    for topic in dict.fromkeys(listed):
        own = tuple(name for name, one in zip(names, sources, strict=True) if one == topic)
        command |= joint_series(bag[topic], own)
    start = max(values.index[0] for values in command.values())
    for joint, values in position.items():
        if values.index[-1] <= start:
            found = f"no position of {joint} after the first set-points"
            raise InputError(path, state_topic, found, "states while commands are sent")
    others: dict[str, pd.Series[float]] = {}
    for field, column in OPTIONAL.items():
        read = joint_series(state, names, field)
        # drivers write 0 for quantities that they do not measure
        others |= {f"{joint}.{column}": values for joint, values in read.items() if values.any()}
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
    alone = state_joints if len(state_joints) == 1 else ()
    names = tuple(joints or first.messages[0].joints or alone)
    if not names:
        expected = f"names in the order of the set-points on {first.topic}, of "
        raise InputError(first.file, "joints", "none named", expected + ", ".join(state_joints))
    if len(set(names)) != len(names):
        raise InputError(first.file, "joints", ", ".join(names), "each name once")
    return names


def check_source(stream: Stream, series: Mapping[str, pd.Series[float]]) -> list[str]:
    """Warnings of angles that lie apart from those before and after them, which agree.

    They are failed readings, or of a second source of the topic. ``series`` are angles in rad of
    each joint by time in ns, in order of time. Fewer than five are left to chance; there is a
    warning above a share of 1 %, an error above 10 %; they lie apart by at least 20 mrad, several
    counts of coarse encoders. ``InputError`` if too many angles contradict others.
    """
    warnings = []
    for joint, values in series.items():
        t, angles = np.asarray(values.index, np.int64), np.asarray(values, np.float64)
        before, after = np.diff(angles)[:-1], -np.diff(angles)[1:]
        size = np.minimum(np.abs(before), np.abs(after))
        agree = np.abs(angles[2:] - angles[:-2])
        # above noise, and common motion
        least = max(8 * float(np.quantile(agree, 0.25)), 0.02) if agree.size else 0.0
        apart = np.flatnonzero((before * after > 0) & (size > np.maximum(5 * agree, least)))
        if apart.size < max(5, 0.01 * angles.size):
            continue
        found = (
            f"{apart.size} of {angles.size} angles of {joint} apart from those before and after "
            f"them (the first {size[apart[0]]:.2g} rad, {(t[apart[0] + 1] - t[0]) / 1e9:.4g} s "
            "after the first message): two publishers, or failed readings"
        )
        if apart.size > 0.1 * angles.size:
            expected = (
                f"messages of one source (ros2 topic info --verbose {stream.topic} lists the "
                "publishers): record again with one, or remove the messages of the other"
            )
            raise InputError(stream.file, stream.topic, found, expected)
        warnings.append(f"{stream.topic}: {found}.")
    return warnings
