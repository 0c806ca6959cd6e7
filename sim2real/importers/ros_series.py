"""Time series of each joint from ROS messages: measurements and commands."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.errors import InputError
from sim2real.importers.ros_messages import Message


def command_topics(
    file: str | os.PathLike[str],
    command_topic: str | Sequence[str] | Mapping[str, str],
    joints: Sequence[str] | None,
) -> dict[str, tuple[str, ...]]:
    """Topics of the set-points, each with its joints; empty for a topic of all joints.

    Raises:
        InputError: If there are several topics but not one for each joint.
    """
    if isinstance(command_topic, Mapping):
        joints = tuple(joints or command_topic)
        topics = [command_topic[joint] for joint in joints if joint in command_topic]
    else:
        topics = [command_topic] if isinstance(command_topic, str) else list(command_topic)
        if len(topics) == 1:
            return {topics[0]: ()}
    if not topics or len(joints or ()) != len(topics):
        found = f"{len(joints or ())} joints and {len(topics)} command topics for them"
        raise InputError(file, "joints", found, "one topic for all or one for each joint")
    pairs = list(zip(joints or (), topics, strict=True))
    return {topic: tuple(j for j, t in pairs if t == topic) for topic in topics}


def joint_names(
    joints: Sequence[str] | None,
    topics: Mapping[str, tuple[str, ...]],
    bag: Mapping[str, Stream],
    state_topic: str,
) -> tuple[str, ...]:
    """The requested joints, else those with a topic, else those named in the first command.

    Raises:
        InputError: If the first command names none and the first state names several, or if a
            name is repeated.
    """
    first, state = bag[next(iter(topics))], bag[state_topic]
    names = tuple(joints or [joint for topic_joints in topics.values() for joint in topic_joints])
    names = names or first.messages[0].joints
    state_joints = state.messages[0].joints
    if not names and len(state_joints) == 1:
        return state_joints
    if not names:
        expected = (
            f"names in the order of the set-points on {first.topic}, of {', '.join(state_joints)}"
        )
        raise InputError(first.file, "joints", "none named", expected)
    if len(set(names)) != len(names):
        raise InputError(first.file, "joints", ", ".join(names), "each name once")
    return names


Times = NDArray[np.int64]
Series = tuple[Times, Array]  # times in ns, not decreasing, and values without NaN: (N,) and (N,)

LARGEST_DELAY_NS = 10**8  # from stamp to receipt, if both are of the same clock
LARGEST_DISORDER_NS = 10**9  # of stamps of a clock that was not set back


@dataclass(frozen=True)
class Stream:
    """The N messages of one topic, with the times of sampling or sending.

    Attributes:
        file: The bag.
        topic: The topic.
        messages: The messages.
        t: Their times in ns, shape (N,).
        clock: Kind of the times.
    """

    file: str | os.PathLike[str]
    topic: str
    messages: Sequence[Message]
    t: Times
    clock: str


def streams(
    file: str | os.PathLike[str], messages: Mapping[str, Sequence[Message]]
) -> dict[str, Stream]:
    """The messages of each topic with their times.

    Header stamps if every message of a topic has one, else receive times. If both differ by more
    than the transmission time of a message, they are of different clocks (simulated time, or
    another computer), and receive times are used for all topics.

    Raises:
        InputError: If a clock was set back.
    """
    receive = {topic: _ns([m.receive_ns for m in sent]) for topic, sent in messages.items()}
    header = {topic: _ns([m.header_ns for m in sent]) for topic, sent in messages.items()}
    stamped = {topic for topic in messages if header[topic].all()}
    delays = [abs(float(np.median(receive[topic] - header[topic]))) for topic in stamped]
    if stamped != set(messages) and max(delays, default=0) > LARGEST_DELAY_NS:
        stamped = set()
    result = {}
    for topic, sent in messages.items():
        t, clock = receive[topic], "receive time"
        if topic in stamped:
            t, clock = header[topic], "header stamp"
        result[topic] = Stream(file, topic, sent, _checked_clock(file, topic, t), clock)
    return result


def joint_series(
    stream: Stream,
    joints: Sequence[str],
    values: Callable[[Message], Mapping[str, float]],
    limit: float = sys.float_info.max,
) -> dict[str, Series]:
    """Series of the joints of a stream; NaN, which drivers send for missing values, is omitted.

    Args:
        stream: Messages and times.
        joints: The joints.
        values: Reads the values by joint name out of one message.
        limit: Largest size of a value.

    Raises:
        InputError: If a message is inconsistent or a value exceeds the limit.
    """
    pairs: dict[str, list[tuple[int, float]]] = {joint: [] for joint in joints}
    for k, (t, message) in enumerate(zip(stream.t.tolist(), stream.messages, strict=True)):
        place = f"{stream.topic}, message {k}"
        try:
            read = values(message)
        except ValueError as error:
            raise InputError(stream.file, place, *error.args) from None
        for joint in joints:
            value = read.get(joint, math.nan)
            if abs(value) > limit:
                expected = f"a size of at most {limit:.3g} (for angles: radians, not degrees)"
                raise InputError(stream.file, f"{place}, {joint}", f"{value:g}", expected)
            if not math.isnan(value):
                pairs[joint].append((t, value))
    return {joint: _in_order(samples) for joint, samples in pairs.items() if samples}


def angle_series(
    stream: Stream, joints: Sequence[str], angles: Callable[[Message], Mapping[str, float]]
) -> dict[str, Series]:
    """`joint_series` of angles in rad, required for every joint.

    Raises:
        InputError: If a joint has none, or see `joint_series`.
    """
    series = joint_series(stream, joints, angles, LARGEST_ANGLE_RAD)
    for joint in joints:
        if joint not in series:
            available = sorted({name for message in stream.messages for name in message.joints})
            expected = f"one of {', '.join(available)}" if available else "one"
            raise InputError(stream.file, stream.topic, f"no angle of joint {joint}", expected)
    return series


def _checked_clock(file: str | os.PathLike[str], topic: str, t: Times) -> Times:
    decreasing = np.flatnonzero(np.diff(t) < -LARGEST_DISORDER_NS)
    if decreasing.size:
        problem = (
            f"a time {(t[decreasing[0]] - t[decreasing[0] + 1]) / 1e9:g} s before the previous one"
        )
        expected = "a clock never set back"
        if decreasing.size > 1:
            problem += f", and {decreasing.size} such times"
            expected += ", or one publisher of the topic instead of two with clocks of their own"
        raise InputError(file, f"{topic}, message {decreasing[0] + 1}", problem, expected)
    return t


def _ns(times: list[int]) -> Times:
    return np.array(times, dtype=np.int64)


def _in_order(samples: list[tuple[int, float]]) -> Series:
    samples.sort(key=lambda sample: sample[0])
    return _ns([t for t, _ in samples]), np.array([value for _, value in samples])
