"""Whether one source writes a topic, judged by the angles of its messages."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.importers.ros_series import Series, Stream, Times

FEWEST = 5
"""Fewest contradictions that are not left to chance."""
LEAST_RAD = 0.02
"""Least size of a contradiction: several counts of coarse encoders."""
LEAST_WARNED, MOST_WARNED = 0.01, 0.1
"""Shares of contradictions that may be failed readings; with more, no result would be right."""
FASTEST_COMMANDS_S = 0.03
"""Set-points that alternate at shorter intervals are not of one source."""


def check_sources(stream: Stream, series: Mapping[str, Series], *, commands: bool) -> list[str]:
    """Check that the angles of each joint on a topic are of one source.

    An angle that lies apart from those before and after it, which agree, contradicts them. Two
    sources are certain where such messages come within a quarter of the usual interval of another
    (equal stamps), at every second, third ... place throughout, or form a moving series of their
    own. Joints that are moved near half the sampling rate, and set-points that are sent as steps,
    do none of these.

    Args:
        stream: The messages.
        series: Times in ns and angles in rad of each joint, in order of time.
        commands: Whether they are set-points, which may jump to and fro by themselves.

    Returns:
        Sentences on what may be a second source, or failed readings.

    Raises:
        InputError: If two sources write the topic, or too many angles contradict others.
    """
    warnings = []
    for joint, (t, angles) in series.items():
        apart, size = _contradictions(angles)
        two = apart.size >= FEWEST and _of_two_sources(t, angles, apart, size, commands)
        share = 0.0 if commands or apart.size < FEWEST else apart.size / angles.size
        if two or share > LEAST_WARNED:
            why = "two publishers" if two else "two publishers, or failed readings"
            found = (
                f"{apart.size} of {angles.size} angles of {joint} apart from those before and "
                f"after them (the first {size[0]:.2g} rad, {(t[apart[0]] - t[0]) / 1e9:.4g} s "
                f"after the first message): {why}"
            )
            if two or share > MOST_WARNED:
                expected = (
                    f"messages of one source (ros2 topic info --verbose {stream.topic} lists the "
                    "publishers): record again with one, or remove the messages of the other"
                )
                raise InputError(stream.file, stream.topic, found, expected)
            warnings.append(f"{stream.topic}: {found}.")
        same = np.flatnonzero((np.diff(t) == 0) & (np.abs(np.diff(angles)) > 1e-6))
        if same.size > 1:
            largest = float(np.abs(np.diff(angles))[same].max())
            warnings.append(
                f"{stream.topic}: {same.size} messages have the same time as the previous one and "
                f"another angle of {joint}, up to {largest:.2g} rad apart, the first "
                f"{(t[same[0]] - t[0]) / 1e9:.4g} s after the first message: two publishers of the "
                "topic, or coarse stamps. The last one is imported."
            )
    return warnings


def _contradictions(angles: Array) -> tuple[NDArray[np.intp], Array]:
    """Places of angles apart from both neighbours, which agree, and their distances in rad."""
    if angles.size < 3:
        return np.empty(0, np.intp), np.empty(0)
    before, after = angles[1:-1] - angles[:-2], angles[1:-1] - angles[2:]
    size = np.minimum(np.abs(before), np.abs(after))
    agree = np.abs(angles[2:] - angles[:-2])
    least = max(8 * float(np.quantile(agree, 0.25)), LEAST_RAD)  # above noise, and common motion
    apart = (before * after > 0) & (size > np.maximum(5 * agree, least))
    return np.flatnonzero(apart) + 1, size[apart]


def _of_two_sources(
    t: Times, angles: Array, apart: NDArray[np.intp], size: Array, commands: bool
) -> bool:
    """Whether messages ``apart`` from their neighbours can only be of a second source."""
    steps = np.diff(t) / 1e9
    usual = float(np.quantile(steps, 0.75))
    nearest = np.minimum(steps[apart - 1], steps[apart])
    if float(np.mean(nearest <= 0.25 * usual)) > 0.5:
        return True
    places = np.diff(apart)
    every = int(np.median(places))
    regular = float(np.mean(places == every)) > 0.8 and every * apart.size > 0.3 * angles.size
    if regular and (not commands or usual < FASTEST_COMMANDS_S):
        return True
    theirs = angles[apart]
    moves = float(np.subtract(*np.quantile(theirs, [0.75, 0.25]))) > LEAST_RAD
    own = float(np.median(np.abs(np.diff(theirs)))) < 0.2 * float(np.median(size))
    return not commands and moves and own
