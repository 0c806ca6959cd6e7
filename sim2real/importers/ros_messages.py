"""Messages of a ROS 1 or ROS 2 bag, read through the rosbags package, and the values in them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.errors import InputError

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
ARRAY = "std_msgs/msg/Float64MultiArray"
FLOAT = "std_msgs/msg/Float64"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
STATE_TYPES = (JOINT_STATE, CONTROLLER)
COMMAND_TYPES = (JOINT_STATE, TRAJECTORY, CONTROLLER, ARRAY, FLOAT)


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes:
        receive_ns: When the bag's recorder received it.
        header_ns: The stamp in its header; 0 where there is none.
        type: Its ROS 2 type name, for ROS 1 too.
        content: Its fields.
    """

    receive_ns: int
    header_ns: int
    type: str
    content: Any

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints it names; none in the types that name none."""
        if self.type == JOINT_STATE:
            return tuple(self.content.name)
        return tuple(self.content.joint_names) if self.type in (TRAJECTORY, CONTROLLER) else ()


def read_messages(
    path: str | os.PathLike[str], wanted: Mapping[str, tuple[str, ...]]
) -> dict[str, list[Message]]:
    """Messages of the wanted topics, in the order received.

    Args:
        path: A ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.
        wanted: The message types allowed, by topic.

    Raises:
        InputError: If the bag can't be read or a topic is missing, empty or of another type.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        expected = "the package rosbags (pip install 'sim2real[ros]')"
        raise InputError(path, "", "a ROS bag and nothing to read it with", expected) from None
    if not Path(path).exists():
        raise InputError(path, "", "no such file", "a ROS 1 or ROS 2 bag")
    messages: dict[str, list[Message]] = {topic: [] for topic in wanted}
    try:
        # Older ROS 2 bags don't carry the definitions of their messages.
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST)) as bag:
            _check_topics(path, wanted, [(c.topic, c.msgtype) for c in bag.connections])
            connections = [c for c in bag.connections if c.topic in wanted]
            for connection, receive_ns, raw in bag.messages(connections):
                content: Any = bag.deserialize(raw, connection.msgtype)
                message = Message(receive_ns, _header_ns(content), connection.msgtype, content)
                messages[connection.topic].append(message)
    except InputError:
        raise
    except Exception as error:  # a damaged bag fails in as many ways as there are storages
        found = f"no bag that can be read ({error})"
        raise InputError(path, "", found, "a ROS 1 or ROS 2 bag") from error
    for topic, received in messages.items():
        if not received:
            raise InputError(path, topic, "0 messages", "at least one")
    return messages


def measured(message: Message, field: str) -> dict[str, float]:
    """``field`` of a JointState by joint name; any field may be left empty.

    Of a controller's state it is that of ``feedback`` (``actual`` before ROS 2 Humble).

    Raises:
        ValueError: If names and values do not match: what was found, what was expected.
    """
    content, name = message.content, field
    if message.type == CONTROLLER:
        content = _point(content, "feedback", "actual")
        name = {"position": "positions", "velocity": "velocities"}.get(field, field)
    values = getattr(content, name)
    return _by_name(message.joints, values, field) if len(values) else {}


def set_points(message: Message, joints: Sequence[str]) -> dict[str, float]:
    """Set-points in rad by joint name; ``joints`` are those that an array or number is for.

    Of a trajectory it is the point that lies ahead (``time_from_start`` above 0, or the only
    point), sent when the trajectory starts: how the controller gets there counts as the servo's
    doing. With several points ahead it is the controller that makes the set-points: they are in the
    ``reference`` (``desired`` before ROS 2 Humble) of its own state.

    Raises:
        ValueError: If names and values do not match, or there are several points ahead.
    """
    if message.type in (FLOAT, ARRAY):
        return _by_name(joints, np.atleast_1d(message.content.data).tolist(), "data")
    if message.type == JOINT_STATE:
        return _by_name(message.joints, message.content.position, "position")
    if message.type == CONTROLLER:
        wanted = _point(message.content, "reference", "desired")
        return _by_name(message.joints, wanted.positions, "positions")
    points = message.content.points
    ahead = [p for p in points if (p.time_from_start.sec, p.time_from_start.nanosec) > (0, 0)]
    chosen = ahead or points
    if len(chosen) != 1:
        expected = "one in each message (or the topic of the controller's own state)"
        raise ValueError(f"{len(chosen)} trajectory points ahead", expected)
    return _by_name(message.joints, chosen[0].positions, "positions")


def _point(content: Any, name: str, before: str) -> Any:  # noqa: ANN401
    """A point of a controller's state by its name now, or its name before if that is empty."""
    point = getattr(content, name, None)
    return point if point is not None and len(point.positions) else getattr(content, before, point)


def _check_topics(
    path: str | os.PathLike[str],
    wanted: Mapping[str, tuple[str, ...]],
    recorded: list[tuple[str, str]],
) -> None:
    there = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(set(recorded))) or "none"
    for topic, allowed in wanted.items():
        kinds = {kind for name, kind in recorded if name == topic}
        if not kinds:
            raise InputError(path, topic, "no such topic in the bag", f"one of: {there}")
        if not kinds <= set(allowed):
            raise InputError(path, topic, ", ".join(sorted(kinds)), " or ".join(allowed))


def _header_ns(content: Any) -> int:  # noqa: ANN401 - rosbags makes a class for each type
    header = getattr(content, "header", None)
    return header.stamp.sec * 10**9 + header.stamp.nanosec if header is not None else 0


def _by_name(names: Sequence[str], values: Sequence[float], field: str) -> dict[str, float]:
    if len(names) != len(values):
        raise ValueError(f"{len(values)} values in {field}", f"one for each of {', '.join(names)}")
    return {name: float(value) for name, value in zip(names, values, strict=True)}
