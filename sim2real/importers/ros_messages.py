"""Messages of ROS 1 and ROS 2 bags, read with the package rosbags, and their values."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.errors import InputError
from sim2real.extras import optional
from sim2real.structured import LARGEST_STREAM_BYTES, check_size

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
        receive_ns: Time at which the recorder received it.
        header_ns: The stamp in its header; 0 if there is none.
        type: Its ROS 2 type name, also for ROS 1.
        content: Its fields.
    """

    receive_ns: int
    header_ns: int
    type: str
    content: Any

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of its joints; empty for types without names."""
        if self.type == JOINT_STATE:
            return tuple(self.content.name)
        return tuple(self.content.joint_names) if self.type in (TRAJECTORY, CONTROLLER) else ()


def read_messages(
    path: str | os.PathLike[str], allowed_types: Mapping[str, tuple[str, ...]]
) -> dict[str, list[Message]]:
    """Messages of the given topics, in the order received.

    Args:
        path: A ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.
        allowed_types: The allowed message types, by topic.

    Raises:
        InputError: If the bag can't be read or a topic is missing, empty or of another type.
    """
    with optional(str(path)):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    if not Path(path).exists():
        raise InputError(path, "", "no such file", "a ROS 1 or ROS 2 bag")
    if not Path(path).is_dir():
        check_size(Path(path), LARGEST_STREAM_BYTES)
    messages: dict[str, list[Message]] = {topic: [] for topic in allowed_types}
    try:
        # Older ROS 2 bags do not contain the definitions of their messages.
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.LATEST)) as bag:
            _check_topics(path, allowed_types, [(c.topic, c.msgtype) for c in bag.connections])
            connections = [c for c in bag.connections if c.topic in allowed_types]
            for connection, receive_ns, raw in bag.messages(connections):
                content: Any = bag.deserialize(raw, connection.msgtype)
                message = Message(receive_ns, _header_ns(content), connection.msgtype, content)
                messages[connection.topic].append(message)
    except InputError:
        raise
    except Exception as error:  # errors of damaged bags depend on the storage
        problem = f"no bag that can be read ({error})"
        raise InputError(path, "", problem, "a ROS 1 or ROS 2 bag") from error
    for topic, received in messages.items():
        if not received:
            raise InputError(path, topic, "0 messages", "at least one")
    return messages


def measured(message: Message, field: str) -> dict[str, float]:
    """``field`` of a JointState by joint name; empty if the field is empty.

    For a controller's state it is that of ``feedback`` (``actual`` before ROS 2 Humble).

    Raises:
        ValueError: If names and values do not match; arguments: found, expected.
    """
    content, name = message.content, field
    if message.type == CONTROLLER:
        content = _point(content, "feedback", "actual")
        name = {"position": "positions", "velocity": "velocities"}.get(field, field)
    values = getattr(content, name)
    return _by_name(message.joints, values, field) if len(values) else {}


def set_points(message: Message, joints: Sequence[str]) -> dict[str, float]:
    """Set-points in rad by joint name; ``joints`` are the names for an array or a number.

    For a trajectory it is the future point (``time_from_start`` above 0, or the only point), sent
    when the trajectory starts: interpolation by the controller is attributed to the servo. With
    several future points the controller computes the set-points: they are in the ``reference``
    (``desired`` before ROS 2 Humble) of its state.

    Raises:
        ValueError: If names and values do not match, or there are several points ahead.
    """
    if message.type in (FLOAT, ARRAY):
        return _by_name(joints, np.atleast_1d(message.content.data).tolist(), "data")
    if message.type == JOINT_STATE:
        return _by_name(message.joints, message.content.position, "position")
    if message.type == CONTROLLER:
        reference = _point(message.content, "reference", "desired")
        return _by_name(message.joints, reference.positions, "positions")
    points = message.content.points
    ahead = [p for p in points if (p.time_from_start.sec, p.time_from_start.nanosec) > (0, 0)]
    chosen = ahead or points
    if len(chosen) != 1:
        expected = "one in each message (or the topic of the controller's own state)"
        raise ValueError(f"{len(chosen)} trajectory points ahead", expected)
    return _by_name(message.joints, chosen[0].positions, "positions")


def _point(content: Any, name: str, before: str) -> Any:  # noqa: ANN401
    """A point of a controller's state by its present or, if empty, its former name."""
    point = getattr(content, name, None)
    return point if point is not None and len(point.positions) else getattr(content, before, point)


def _check_topics(
    path: str | os.PathLike[str],
    allowed_types: Mapping[str, tuple[str, ...]],
    recorded: list[tuple[str, str]],
) -> None:
    recorded_topics = (
        ", ".join(f"{topic} ({kind})" for topic, kind in sorted(set(recorded))) or "none"
    )
    for topic, allowed in allowed_types.items():
        kinds = {kind for name, kind in recorded if name == topic}
        if not kinds:
            raise InputError(path, topic, "no such topic in the bag", f"one of: {recorded_topics}")
        if not kinds <= set(allowed):
            raise InputError(path, topic, ", ".join(sorted(kinds)), " or ".join(allowed))


def _header_ns(content: Any) -> int:  # noqa: ANN401 - rosbags makes a class for each type
    header = getattr(content, "header", None)
    return header.stamp.sec * 10**9 + header.stamp.nanosec if header is not None else 0


def _by_name(names: Sequence[str], values: Sequence[float], field: str) -> dict[str, float]:
    if len(names) != len(values):
        raise ValueError(f"{len(values)} values in {field}", f"one for each of {', '.join(names)}")
    return {name: float(value) for name, value in zip(names, values, strict=True)}
