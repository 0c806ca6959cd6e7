"""Play of a servo that others pull to either side: where its shaft rests under no command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.recording import Recording


@dataclass(frozen=True)
class Play:
    """Difference between the shaft's mean angles after and during pulls to either side, rad.

    Attributes:
        unloaded_rad: After release: the gap, dead band and friction that keep the shaft where it
            was pulled to.
        loaded_rad: While pulled: the deflection of controller and gears under the pull as well.
    """

    unloaded_rad: float
    loaded_rad: float


def play_between_pulls(
    recording: Recording,
    joint: str,
    *,
    settling_s: float = 0.35,
    window_s: float = 0.5,
    tolerance_rad: float = 0.01,
) -> Play | None:
    """Play of a joint that two other servos pull by elastic bands, one to either side.

    A static estimate; it needs no model of the servo. The sidecar's ``external_load`` states under
    ``relaxed_and_tensioned_command_rad`` at which commands each puller's band is slack and tense.
    Only windows in which the joint keeps the command that it had when the pull began count.

    Args:
        recording: The recording.
        joint: Name of the pulled joint.
        settling_s: Time after a change of the pulling servo's command that is left out: its own
            motion and the age of the telemetry.
        window_s: Longest window after it over which the angle is averaged.
        tolerance_rad: Largest difference from the tensioned command.

    Returns:
        The play; None if the sidecar states no pullers or one of them never pulls.
    """
    pullers = _tensioned(recording)
    if len(pullers) != 2 or joint in pullers:
        return None
    t, j = recording.t, recording.joints.index(joint)
    position, command = recording.position[:, j], recording.command[:, j]
    tense = {
        name: np.abs(recording.command[:, recording.joints.index(name)] - end) < tolerance_rad
        for name, end in pullers.items()
    }
    any_pull = np.any(list(tense.values()), axis=0)
    sides = []
    for pulling in tense.values():
        edges = np.flatnonzero(np.diff(pulling.astype(int), prepend=0, append=0))
        pulled: list[float] = []
        released: list[float] = []
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            end = min(last, t.size - 1)
            for values, start, stop, must_be_free in (
                (pulled, t[first] + settling_s, t[end] + settling_s, False),
                (released, t[end] + settling_s, np.inf, True),
            ):
                inside = (t >= start) & (t < min(stop, start + window_s))
                steady = inside.any() and np.all(command[inside] == command[first])
                if steady and not (must_be_free and any_pull[inside].any()):
                    values.append(float(np.nanmean(position[inside])))
        if not pulled or not released:
            return None
        sides.append((float(np.mean(released)), float(np.mean(pulled))))
    first_side, second_side = sides
    return Play(abs(first_side[0] - second_side[0]), abs(first_side[1] - second_side[1]))


def _tensioned(recording: Recording) -> dict[str, float]:
    """Command in rad at which the band of each puller is tense, where the sidecar states it."""
    load = recording.metadata.get("external_load")
    ends = load.get("relaxed_and_tensioned_command_rad") if isinstance(load, dict) else None
    if not isinstance(ends, dict):
        return {}
    return {
        name: float(pair[1])
        for name, pair in ends.items()
        if name in recording.joints
        and isinstance(pair, list)
        and len(pair) == 2
        and all(isinstance(end, int | float) for end in pair)
    }
