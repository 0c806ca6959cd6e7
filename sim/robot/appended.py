"""The appendages of a robot as arrays for ``sim.robot.outside``: points of drag, added mass.

Each appendage resists at two points along its longer side, at the quadrature points of Gauss, and
its added mass is spread over its length and width, so that it has a moment of inertia too.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import sqrt

import numpy as np

from sim.lattice.units import WATER_KG_M3
from sim.robot.shape import Hull
from sim2real.appendages import Wetted, area_error
from sim2real.arrays import Array
from sim2real.robot import Robot

_GAUSS = (-1 / sqrt(12), 1 / sqrt(12))
"""Places of two points in units of a length, about its middle."""


def points_of(robot: Robot, hull: Hull, surface_m: float) -> Array:
    """Points at which the appendages resist, shape (L, P, 4), with P at least 1.

    The last point of each link is unused, for ``body_effect.Forces.area``.

    Args:
        robot: The robot.
        hull: Its hull, whose first axis begins behind the nose.
        surface_m: Height of the water's surface above the hull's middle.

    Returns:
        Distance behind the start of the link's axis and to the left of it in m, and drag along and
        across the link in N s2/m2.
    """
    most = 2 * max(len(link.appendages) for link in robot.links) + 1
    out = np.zeros((len(robot.links), most, 4))
    for k, link in enumerate(robot.links):
        for i, wetted in enumerate(one.wetted(surface_m) for one in link.appendages):
            longer = int(np.argmax(wetted.length_m))
            for j, share in enumerate(_GAUSS):
                point = out[k, 2 * i + j]
                point[:2] = wetted.place_m
                point[longer] += share * wetted.length_m[longer]
                point[2:] = WATER_KG_M3 / 4 * np.array(wetted.area_m2)
    out[0, :, 0] -= hull.half_width[0, 0]
    return out


def added_mass_of(robot: Robot, hull: Hull, surface_m: float) -> Array:
    """Added mass of the appendages of each link, shape (L, 3, 3).

    The matrix from velocity along the link, across it and of its heading, at the start of its axis,
    to momentum along, momentum across and angular momentum about the start.
    """
    out = np.zeros((len(robot.links), 3, 3))
    for k, link in enumerate(robot.links):
        front = hull.half_width[0, 0] if k == 0 else 0.0
        for wetted in (one.wetted(surface_m) for one in link.appendages):
            for i, j in product(_GAUSS, _GAUSS):
                ahead = front - wetted.place_m[0] + i * wetted.length_m[0]
                left = wetted.place_m[1] + j * wetted.length_m[1]
                along, across = np.array([1.0, 0.0, -left]), np.array([0.0, 1.0, ahead])
                shares = WATER_KG_M3 / 4 * np.array(wetted.added_mass_m3)
                out[k] += shares[0] * np.outer(along, along) + shares[1] * np.outer(across, across)
    return out


def about(matrix: Array, ahead: Array, left: Array) -> Array:
    """Matrices (..., 3, 3) of ``added_mass_of`` about points ahead of the start and to its left."""
    shift = np.zeros((*np.broadcast_shapes(ahead.shape, left.shape), 3, 3))
    shift[..., range(3), range(3)] = 1.0
    shift[..., 0, 2], shift[..., 1, 2] = left, -ahead
    return np.asarray(np.swapaxes(shift, -1, -2) @ matrix @ shift)


def wetted_of(robot: Robot, surface_m: float) -> Sequence[Wetted]:
    """All appendages in the water, from head to tail."""
    return [one.wetted(surface_m) for one in robot.appendages]


def area_sd(robot: Robot, surface_m: float = np.inf) -> float:
    """Relative standard deviation of the drag areas that the robot file states."""
    return area_error(wetted_of(robot, surface_m))
