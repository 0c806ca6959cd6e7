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
    """Quantities that effects change, for one robot with L links; all 0 without effects."""

    lengths_m: Array  # lengths of the links, shape (L,)
    materials: tuple[str, ...]  # materials of their surfaces
    frontal_m2: float  # area of the largest cross-section
    water_kg_m3: float  # density of the water
    com: float = 0.0  # distance in m by which the centres of mass are further back
    side: float = 0.0  # distance in m of the centres of mass to the left of the axis
    rough: Array = field(init=False)  # additional friction coefficient of each link's surface, (L,)
    # for each link, linear drag in N s/m, quadratic drag along its axis in N s2/m2, and added mass
    # normal to it and in rotation as shares of the displaced water, (L, 4)
    resist: Array = field(init=False)
    # for the skin over each joint, stiffness in N m/rad, damping in N m s/rad, stiffness that
    # relaxes in N m/rad and its relaxation time in s, (L - 1, 4)
    skin: Array = field(init=False)
    areas: float = 0.0  # relative error of the drag areas of the robot file's appendages
    lacking: float = 0.0  # drag area in m2 that the file lacks, along and across its link
    lacking_at: float = 0.0  # its distance in m behind the front of the straight robot
    coupling: float = 0.0  # stiffness in N m/rad between neighbouring joints
    # stiffness in N/m of a cable on the head, and x and y of its anchor in m, (3,)
    tether: Array = field(default_factory=lambda: np.zeros(3))
    trim: float = 0.0  # offset of all joints in rad
    # velocity of the pool's water in m/s, (2,)
    current: Array = field(default_factory=lambda: np.zeros(2))
    wall: float = 0.0  # relative increase of the thrust by a wall at a distance of one body length

    def __post_init__(self) -> None:
        links = self.lengths_m.size
        self.rough = np.zeros(links)
        self.resist, self.skin = np.zeros((links, 4)), np.zeros((links - 1, 4))

    def made_of(self, material: str) -> Array:
        """1 for the links of a material, or for all where it is empty, else 0, shape (L,)."""
        return np.array([float(material in ("", other)) for other in self.materials])


@dataclass(frozen=True, kw_only=True)
class SwimEffect:
    """What effects of the body and of the camera have in common."""

    name: str  # its identifier
    plain: str  # description for use in a sentence
    # description before a colon and its size, without direction if the size may have either sign
    title: str
    parameters: tuple[Parameter, ...]  # its parameters, all 0 where it is absent
    order: int = 99  # position in lists, and in the sequence of effects on the poses
    by_material: bool = False  # whether each material has separate parameters


@dataclass(frozen=True, kw_only=True)
class BodyEffect(SwimEffect):
    """Physics of the body that the simulator omits by default."""

    # adds the effect to the forces, from parameters and a material (empty for all)
    act: Callable[[Forces, Values, str], None]


@dataclass(frozen=True, kw_only=True)
class CameraEffect(SwimEffect):
    """An error of the poses that the camera measures."""

    # measured poses from even times in s (T,), true poses (T, 3) and parameters
    see: Callable[[Array, Array, Values], Array]


def late(t: Array, pose: Array, delay_s: float) -> Array:
    """Poses (T, 3) delayed by ``delay_s``, starting with the first pose."""
    if not delay_s:
        return pose
    return np.stack([np.interp(t - delay_s, t, column) for column in pose.T], axis=1)
