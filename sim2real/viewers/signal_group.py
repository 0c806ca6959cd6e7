"""What a viewer shows: signals over time, and lines that move in space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array

COMMAND, MEASURED, PREDICTED = "command", "measured", "predicted"
"""Names of signals; a command holds until the next one."""

TRACK_COLOURS = ((90, 160, 255), (255, 125, 92), (150, 150, 150))
"""Red, green and blue of successive tracks, 0 to 255."""


@dataclass(frozen=True)
class SignalGroup:
    """Signals of one quantity on one time axis.

    Attributes:
        path: Where it belongs, outermost first: ``("steps", "j1", "position")``.
        unit: SI unit of all signals; empty for pure numbers.
        t: Times in s, shape (T,), increasing.
        signals: Values by name, each of shape (T,), NaN where missing. Signals without any value
            are left out.
    """

    path: tuple[str, ...]
    unit: str
    t: Array
    signals: Mapping[str, Array]

    def __post_init__(self) -> None:
        valued = {name: x for name, x in self.signals.items() if np.isfinite(x).any()}
        object.__setattr__(self, "signals", valued)


@dataclass(frozen=True)
class MovingLine:
    """A line that moves: the axis of a robot from its head to its tail.

    Attributes:
        path: Where it belongs, outermost first: ``("swim", "measured")``.
        t: Times in s, shape (T,), increasing.
        points: Ends and joints of its links in m, world frame, shape (T, L + 1, 3), finite.
    """

    path: tuple[str, ...]
    t: Array
    points: Array


@dataclass(frozen=True)
class Scene:
    """What a file for a viewer holds; ``a + b`` holds both, with the signals of equal paths merged.

    Attributes:
        groups: Signals over time.
        tracks: Lines that move in space.
    """

    groups: tuple[SignalGroup, ...] = ()
    tracks: tuple[MovingLine, ...] = ()

    def __add__(self, other: Scene) -> Scene:
        """Return the contents of both; times of equal paths must be equal."""
        groups = {group.path: group for group in self.groups}
        for group in other.groups:
            known = groups.get(group.path)
            if known is not None:
                if not np.array_equal(known.t, group.t):
                    raise ValueError(f"{'/'.join(group.path)}: two time axes")
                signals = {**known.signals, **group.signals}
                group = SignalGroup(known.path, known.unit, known.t, signals)
            groups[group.path] = group
        return Scene(tuple(groups.values()), self.tracks + other.tracks)
