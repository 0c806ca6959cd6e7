"""Definitions of effects of the body in the water and of the camera above it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sim2real.arrays import Array
from sim2real.inference.parameters import Parameter

Values = Mapping[str, float]
"""Parameters of one effect, by name."""


@dataclass
class Forces:
    """Quantities that effects change, for one robot with L links; all 0 without effects.

    Attributes:
        lengths_m: Lengths of the links, shape (L,).
        materials: Materials of their surfaces.
        frontal_m2: Area of the largest cross-section.
        water_kg_m3: Density of the water.
        com: Distance in m by which the centres of mass are further back.
        side: Distance in m of the centres of mass to the left of the axis.
        rough: Additional friction coefficient of each link's surface, (L,).
        resist: For each link, linear drag in N s/m, quadratic drag along its axis in N s2/m2, and
            added mass normal to it and in rotation as shares of the displaced water, (L, 4).
        areas: Relative error of the drag areas of the robot file's appendages.
        lacking: Drag area in m2 that the file lacks, along and across its link.
        lacking_at: Its distance in m behind the front of the straight robot.
        skin: For the skin over each joint, stiffness in N m/rad, damping in N m s/rad, stiffness
            that relaxes in N m/rad and its relaxation time in s, (L - 1, 4).
        coupling: Stiffness in N m/rad between neighbouring joints.
        tether: Stiffness in N/m of a cable on the head, and x and y of its anchor in m, (3,).
        trim: Offset of all joints in rad.
        current: Velocity of the pool's water in m/s, (2,).
        wall: Relative increase of the thrust by a wall at a distance of one body length.
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
    areas: float = 0.0
    lacking: float = 0.0
    lacking_at: float = 0.0
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
        return np.array([float(material in ("", other)) for other in self.materials])


@dataclass(frozen=True, kw_only=True)
class SwimEffect:
    """What effects of the body and of the camera have in common.

    Attributes:
        name: Its identifier.
        plain: Description for use in a sentence.
        title: Description before a colon and its size, without direction if the size may have
            either sign.
        parameters: Its parameters, all 0 where it is absent.
        order: Position in lists, and in the sequence of effects on the poses.
        by_material: Whether each material has separate parameters.
    """

    name: str
    plain: str
    title: str
    parameters: tuple[Parameter, ...]
    order: int = 99
    by_material: bool = False


@dataclass(frozen=True, kw_only=True)
class BodyEffect(SwimEffect):
    """Physics of the body that the simulator omits by default.

    Attributes:
        act: Adds the effect to the forces, from parameters and a material (empty for all).
    """

    act: Callable[[Forces, Values, str], None]


@dataclass(frozen=True, kw_only=True)
class CameraEffect(SwimEffect):
    """An error of the poses that the camera measures.

    Attributes:
        see: Measured poses from even times in s (T,), true poses (T, 3) and parameters.
    """

    see: Callable[[Array, Array, Values], Array]


def late(t: Array, pose: Array, delay_s: float) -> Array:
    """Poses (T, 3) delayed by ``delay_s``, starting with the first pose."""
    if not delay_s:
        return pose
    return np.stack([np.interp(t - delay_s, t, column) for column in pose.T], axis=1)
