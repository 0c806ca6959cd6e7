"""What an effect of the body in the water, or of the camera above it, is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim2real.inference.parameters import Parameter

Array = NDArray[np.float64]


@dataclass
class Forces:
    """What acts on one robot of L links beside the water, to which each effect adds its own.

    Attributes:
        lengths_m: Of the links, shape (L,).
        materials: Of their surfaces.
        frontal_m2: Area of the largest cross-section.
        water_kg_m3: Density of the water.
        com: Distance in m by which the centres of mass lie further back.
        side: Distance in m of the centres of mass to the left of the axis.
        rough: Added friction coefficient of each link's surface, (L,).
        resist: Of each link: drag in N s/m, drag along its axis in N s2/m2, share of the displaced
            water that goes along across it and as it turns, (L, 4).
        skin: Over each joint: N m/rad, N m s/rad, N m/rad that relax, their time in s, (L - 1, 4).
        coupling: N m/rad between neighbouring joints.
        tether: N/m on the head, and the anchor's x and y in m, (3,).
        trim: Angle in rad by which the joints are off.
        current: Velocity of the pool's water in m/s, (2,).
        wall: Share by which a wall one body length away adds to the thrust.
    """

    lengths_m: Array
    materials: tuple[str, ...]
    frontal_m2: float
    water_kg_m3: float
    com: float = 0.0
    side: float = 0.0
    rough: Array = field(init=False)
    resist: Array = field(init=False)
    skin: Array = field(init=False)
    coupling: float = 0.0
    tether: Array = field(default_factory=lambda: np.zeros(3))
    trim: float = 0.0
    current: Array = field(default_factory=lambda: np.zeros(2))
    wall: float = 0.0

    def __post_init__(self) -> None:
        links = self.lengths_m.size
        self.rough = np.zeros(links)
        self.resist, self.skin = np.zeros((links, 4)), np.zeros((links - 1, 4))

    def made_of(self, material: str) -> Array:
        """1 for the links of a material, or for all where it is empty, else 0, shape (L,)."""
        return np.array([float(material in ("", one)) for one in self.materials])


@dataclass(frozen=True)
class BodyEffect:
    """Physics of the body that a plain simulator leaves out.

    Attributes:
        name: Its identifier.
        plain: What it is, in plain words, to stand in a sentence.
        title: What it is, before a colon and its size. It has no word of direction where the size
            may have either sign.
        parameters: All 0 where it is off.
        act: Adds what parameters do to what acts on a robot; the last argument is the material, or
            nothing.
        by_material: Whether each material has its own.
        order: Its place in lists.
    """

    name: str
    plain: str
    title: str
    parameters: tuple[Parameter, ...]
    act: Callable[[Forces, Mapping[str, float], str], None]
    by_material: bool = False
    order: int = 99

    camera = False
    """Whether it belongs to the camera."""


@dataclass(frozen=True)
class CameraEffect:
    """What the camera makes of true poses.

    Attributes:
        name: Its identifier.
        plain: What it is, in plain words, to stand in a sentence.
        title: What it is, before a colon and its size. It has no word of direction where the size
            may have either sign.
        parameters: All 0 where it is off.
        see: From even times in s (T,), poses (T, 3) and parameters to the poses that are given.
        order: In which order effects act on the poses.
    """

    name: str
    plain: str
    title: str
    parameters: tuple[Parameter, ...]
    see: Callable[[Array, Array, Mapping[str, float]], Array]
    order: int = 99

    camera = True
    by_material = False


def late(t: Array, pose: Array, delay_s: float) -> Array:
    """Poses (T, 3) of ``delay_s`` before, the first held where there are none."""
    if not delay_s:
        return pose
    return np.stack([np.interp(t - delay_s, t, column) for column in pose.T], axis=1)
