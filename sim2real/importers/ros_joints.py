"""Which joints of a bag to read, and which topics hold their set-points."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from sim2real.errors import InputError
from sim2real.importers.ros_series import Stream


def command_topics(
    file: str | os.PathLike[str],
    command_topic: str | Sequence[str] | Mapping[str, str],
    joints: Sequence[str] | None,
) -> dict[str, tuple[str, ...]]:
    """Topics of the set-points, each with the joints it is for; without any if it is for all.

    Raises:
        InputError: If there are several topics and not one for each joint.
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
    """The joints asked for, else those with a topic, else those that the first command names.

    Raises:
        InputError: If the first command names none and the first state names several, or if a
            name stands twice.
    """
    first, state = bag[next(iter(topics))], bag[state_topic]
    names = tuple(joints or [joint for own in topics.values() for joint in own])
    names = names or first.messages[0].joints
    seen = state.messages[0].joints
    if not names and len(seen) == 1:
        return seen
    if not names:
        expected = f"names in the order of the set-points on {first.topic}, of {', '.join(seen)}"
        raise InputError(first.file, "joints", "none named", expected)
    if len(set(names)) != len(names):
        raise InputError(first.file, "joints", ", ".join(names), "each name once")
    return names
