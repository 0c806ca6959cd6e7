"""Definitions of effects of the body in the water and of the camera above it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sim2real.arrays import Array
from sim2real.inference.parameters import Parameter

Values = Mapping[str, float]
"""Parameters of one effect, by name."""


@dataclass(frozen=True)
class SwimmingBody:
    """A robot with L links, as its effects need it."""

    lengths_m: Array  # lengths of the links, shape (L,)
    materials: tuple[str, ...]  # materials of their surfaces
    frontal_m2: float  # area of the largest cross-section
    water_kg_m3: float  # density of the water

    def made_of(self, material: str) -> Array:
        """1 for the links of a material, or for all where it is empty, else 0, shape (L,)."""
        return np.array([float(material in ("", other)) for other in self.materials])

    def on_head(self, drag: float) -> Array:
        """``resist`` with this quadratic drag of the first link in N s2/m2, shape (L, 4)."""
        return np.outer(np.arange(self.lengths_m.size) == 0, (0.0, drag, 0.0, 0.0))


def no_forces(links: int) -> dict[str, Array]:
    """Quantities that effects add to, by name, for one robot: all 0."""
    return {
        "com": np.zeros(()),  # distance in m by which the centres of mass are further back
        "side": np.zeros(()),  # distance in m of the centres of mass to the left of the axis
        "rough": np.zeros(links),  # additional friction coefficient of each link's surface
        # of each link, linear drag in N s/m, quadratic drag along its axis in N s2/m2, and added
        # mass normal to it and in rotation as shares of the displaced water
        "resist": np.zeros((links, 4)),
        # of the skin over each joint, stiffness in N m/rad, damping in N m s/rad, stiffness that
        # relaxes in N m/rad and its relaxation time in s
        "skin": np.zeros((links - 1, 4)),
        "areas": np.zeros(()),  # relative error of the drag areas of the robot file's appendages
        "lacking": np.zeros(()),  # drag area in m2 that the file lacks, along and across its link
        "lacking_at": np.zeros(()),  # its distance in m behind the front of the straight robot
        "coupling": np.zeros(()),  # stiffness in N m/rad between neighbouring joints
        "tether": np.zeros(3),  # stiffness in N/m of a cable on the head, its anchor's x, y in m
        "trim": np.zeros(()),  # offset of all joints in rad
        "current": np.zeros(2),  # velocity of the pool's water in m/s
        "wall": np.zeros(()),  # relative increase of the thrust by a wall one body length away
    }


@dataclass(frozen=True, kw_only=True)
class SwimEffect:
    """What effects of the body and of the camera have in common."""

    name: str = ""  # its identifier: the name of its file
    plain: str  # description for use in a sentence
    # description before a colon and its size, without direction if the size may have either sign
    title: str
    parameters: tuple[Parameter, ...]  # its parameters, all 0 where it is absent
    order: int = 99  # position in lists, and in the sequence of effects on the poses
    by_material: bool = False  # whether each material has separate parameters


@dataclass(frozen=True, kw_only=True)
class BodyEffect(SwimEffect):
    """Physics of the body that the simulator omits by default."""

    # what it adds to ``no_forces``, given a robot, parameters and a material (empty for all)
    adds: Callable[[SwimmingBody, Values, str], Mapping[str, ArrayLike]]


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
