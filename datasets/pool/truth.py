"""What is concealed of one robot and its water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AREAS = 1.08
"""True drag area of the bar on the robot that ships, relative to that of its file."""


@dataclass(frozen=True)
class Truth:
    """One robot's world; SI.

    Attributes:
        name: Of the recording.
        effects: What is concealed: identifier and parameters.
        kp, kd, latency: Of the servos.
        areas: Drag areas of the appendages, relative to those that the robot file states.
    """

    name: str
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    kp: tuple[float, ...] = (2.1, 2.0, 1.9)
    kd: tuple[float, ...] = (0.075, 0.07, 0.066)
    latency: tuple[float, ...] = (0.062, 0.066, 0.071)
    areas: float = 1.0


def values(truths: Sequence[Truth], effect: str, name: str) -> Array:
    """A parameter of each robot, shape (E,), 0 where it has no such effect."""
    return np.array([truth.effects.get(effect, {}).get(name, 0.0) for truth in truths])
