"""The robot's hull: round links with a continuous surface, whose width and height follow the body.

A link is the set of points nearer to its axis than a radius that varies along it, closed by round
ends; neighbours share the radius at their joint. Across, sections are ellipses.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from sim.fluid.section import RAMP
from sim.lattice.velocities import WATER_KG_M3
from sim2real.appendages import Appendage
from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.robot import Robot

_NOSE, _TIP = 0.6, 0.3
"""Width of the nose and of the tail's tip, relative to the widest of their links."""


@dataclass(frozen=True)
class Hull:
    """Shape of each link."""

    length: Array  # from joint to joint in m, shape (L,)
    half_width: Array  # at the front, middle and back of each link in m, shape (L, 3)
    half_height: Array  # likewise; unused in two dimensions

    @property
    def body_length(self) -> float:
        """From the nose to the tip of the tail in m."""
        return float(self.length.sum() + self.half_width[0, 0] + self.half_width[-1, 2])

    @property
    def extent(self) -> float:
        """The largest of length, width and height in m."""
        return max(
            self.body_length, *(2 * float(x.max()) for x in (self.half_width, self.half_height))
        )


def between(ends: Array, s: Array) -> Array:
    """The quadratic through values (..., 3) at 0, 1/2 and 1, at shares ``s`` of the way."""
    curve = np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)])
    return np.tensordot(ends, curve, 1)


def hull_of(robot: Robot) -> Hull:
    """The hull of links with length, width and height; joints are as wide as the narrower link."""
    width = np.array([link.width_m for link in robot.links]) / 2
    height = np.array([link.height_m for link in robot.links]) / 2
    length = np.array([link.length_m for link in robot.links])
    half_width, half_height = _profile(width, _NOSE, _TIP), _profile(height, _NOSE, 1.0)
    length[0] -= half_width[0, 0]
    length[-1] -= half_width[-1, 2]
    return Hull(length, half_width, half_height)


def _profile(size: Array, nose: float, tip: float) -> Array:
    joints = np.minimum(size[:-1], size[1:])
    front = np.concatenate([[nose * size[0]], joints])
    back = np.concatenate([joints, [tip * size[-1]]])
    middle = (front + back) / 2
    middle[0] = size[0]
    return np.stack([front, middle, back], axis=1)


def draught(hull: Hull, mass_kg: float, appendages: tuple[Appendage, ...] = ()) -> float | None:
    """Height in m of the water above the floating robot's middle (Archimedes); None: it sinks."""
    step = hull.extent / 60

    def excess_mass(surface: float) -> float:
        volume = displaced(hull, step, 0.0, False, surface)[:, 0].sum()
        volume += sum(appendage.displaced_m3(surface) for appendage in appendages)
        return float(WATER_KG_M3 * volume) - mass_kg

    reach = [appendage.at_m[2] + appendage.size_m[2] / 2 for appendage in appendages]
    highest = max(float(hull.half_height.max()), *reach, 0.0)
    if excess_mass(highest) <= 0:
        return None
    lowest = -highest
    if excess_mass(lowest) > 0:  # a robot so light that it floats on the surface
        lowest -= 2 * step
        if excess_mass(lowest) > 0:
            raise _too_light(mass_kg, sum(a.displaced_m3(lowest) for a in appendages))
    return float(brentq(excess_mass, lowest, highest, xtol=1e-4))


def _too_light(mass_kg: float, appendages_m3: float) -> InputError:
    found = f"appendages that displace {WATER_KG_M3 * appendages_m3:.3g} kg of water"
    return InputError("robot", "links", found, f"less than the robot's {mass_kg:.3g} kg")


@lru_cache(maxsize=64)
def submerged(robot: Robot, flat: bool, deep: float) -> tuple[Hull, float, float]:
    """The hull in the water, the depth that replaces its heights in 2D, and that of its middle, m.

    A robot floats at the draught of its mass. One that would sink, and any in two dimensions, has
    its heights scaled so that it displaces its own mass, under water at the depth ``deep``.
    """
    hull, appendages = hull_of(robot), robot.appendages
    mass_kg = sum(link.mass_kg for link in robot.links)
    depth_m = None if flat else draught(hull, mass_kg, appendages)
    if depth_m is not None:
        return hull, 0.0, depth_m
    fine = float(hull.half_width.min()) / 2
    volume = displaced(hull, max(fine, hull.extent / 150), 0.0, flat)[:, 0].sum()
    carried = sum(appendage.displaced_m3(np.inf) for appendage in appendages)
    share = (mass_kg / WATER_KG_M3 - carried) / float(volume)
    if share <= 0:
        raise _too_light(mass_kg, carried)
    return hull if flat else replace(hull, half_height=share * hull.half_height), share, deep


def displaced(hull: Hull, cell: float, inset: float, flat: bool, above: float = np.inf) -> Array:
    """Displaced volume of the straight hull on a grid; a cell belongs to its nearest link.

    From the side of a cell, the distance by which the surface is moved inwards and the height of
    the water's surface ``above`` the hull's middle, all in m, to volume in m3 (area in m2),
    distance of its centre from the link's front end in m, and second moment about that centre in m5
    (m4): (L, 3).
    """
    fine = cell / 6
    widest, highest = hull.half_width.max() + cell, hull.half_height.max() + cell
    count = 2 * round((hull.length.sum() / 2 + widest) / fine)  # equal halves for a symmetric body
    x = (np.arange(count) + 0.5 - count / 2) * fine - hull.length.sum() / 2
    y = np.arange(fine / 2, widest, fine)
    z = np.array([0.0])
    if not flat:
        layers = max(0, round((min(above, highest) + highest) / fine))
        z = min(above, highest) - fine * (np.arange(layers) + 0.5)
    front = -np.concatenate([[0.0], np.cumsum(hull.length)[:-1]])
    X, Y = np.meshgrid(x, y, indexing="ij")
    distance, width, height, depth = [], [], [], []
    for k, start in enumerate(front):
        back = np.clip(start - X, 0, hull.length[k])
        s = back / hull.length[k] if hull.length[k] > 0 else np.zeros_like(back)
        distance.append(np.hypot(X - start + back, Y))
        width.append(between(hull.half_width[k], s) - inset)
        height.append(between(hull.half_height[k], s) - inset)
        depth.append(distance[-1] - width[-1])
    owner = np.argmin(depth, axis=0)
    out = np.zeros((front.size, 3))
    for k, start in enumerate(front):
        cells = owner == k
        o, w, h = distance[k][cells][:, None], width[k][cells][:, None], height[k][cells][:, None]
        ratio = w / h if not flat else np.ones_like(w)
        stretched = np.maximum(np.hypot(o, z * ratio), 1e-12)
        slope = np.hypot(o, z * ratio**2) / stretched if not flat else 1.0
        share = np.clip(0.5 - (stretched - w) / slope / (RAMP * cell), 0, 1).sum(axis=1)
        share *= 2 * fine**2 if flat else 2 * fine**3
        back = start - X[cells]
        volume = max(float(share.sum()), 1e-12)
        centre = (share * back).sum() / volume
        out[k] = volume, centre, (share * ((back - centre) ** 2 + Y[cells] ** 2)).sum()
    return out
