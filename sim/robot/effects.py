"""The body's effects of models, and a robot's appendages, as arrays for ``sim.robot.outside``.

Each appendage resists at two points along its longer side, at the quadrature points of Gauss.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from math import sqrt

import numpy as np

from sim.lattice.velocities import WATER_KG_M3
from sim.robot.shape import Hull
from sim2real.appendages import area_error
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.effects import BODY
from sim2real.effects.body_effect import SwimmingBody, no_forces
from sim2real.model import Model
from sim2real.robot import Robot

_GAUSS = (-1 / sqrt(12), 1 / sqrt(12))
"""Places of two points in units of a length, about its middle."""


Outside = dict[str, Array]
"""Effects on E robots in addition to the fluid's forces: the quantities of ``no_forces``, ``point``
of ``points_of`` and ``laden`` of ``added_mass_of``, E rows each; ``com``, ``side`` and
``trim`` have the shape (E, 1)."""


def outside(
    robot: Robot, models: Sequence[Model], hull: Hull, surface_m: float = np.inf
) -> Outside:
    """Sums of the models' effects, and the appendages; ``surface_m`` is above the hull's middle."""
    largest = np.pi * float((hull.half_width * hull.half_height).max())
    materials = tuple(link.material or "" for link in robot.links)
    body = SwimmingBody(np.asarray(hull.length), materials, largest, WATER_KG_M3)
    points, start = points_of(robot, hull, surface_m), np.cumsum(hull.length)[:-1]
    summed = []
    for model in models:
        forces, parameters = no_forces(len(robot.links)), values(model)
        for effect in BODY:
            names = [name for name in parameters if name.partition(".")[0] == effect.name]
            kinds = (name.split(".")[1] if effect.by_material else "" for name in names)
            for material in dict.fromkeys(kinds):
                prefix = f"{effect.name}.{material}" if effect.by_material else effect.name
                of = {p.name: parameters.get(f"{prefix}.{p.name}", 0.0) for p in effect.parameters}
                for name, added in effect.adds(body, of, material).items():
                    forces[name] = forces[name] + np.asarray(added)
        # The errors of the appendages' areas, and the area that the file lacks.
        point = points.copy()
        point[:, :, 2:] *= 1 + forces["areas"]
        behind = forces["lacking_at"] - hull.half_width[0, 0]
        k = int(np.searchsorted(start, behind, side="right"))
        drag = 0.5 * WATER_KG_M3 * forces["lacking"]
        point[k, -1] = behind - (start[k - 1] if k else 0.0), 0.0, drag, drag
        summed.append(forces | {"point": point})
    return _stacked(summed) | {"laden": added_mass_of(robot, hull, surface_m)[None]}


def _stacked(forces: Sequence[Mapping[str, Array]]) -> Outside:
    stacked = {name: np.array([one[name] for one in forces]) for name in forces[0]}
    return stacked | {name: stacked[name][:, None] for name in ("com", "side", "trim")}


def no_effects(links: int) -> Outside:
    """Those of one robot without any."""
    off = no_forces(links) | {"point": np.zeros((1, 4)), "laden": np.zeros((3, 3))}
    return _stacked([off])


def surface_drag(outside: Outside, hull: Hull) -> Array:
    """Drag rho / 2 x area of the added friction along each link in N s2/m2, shape (E, L)."""
    around = np.pi * (hull.half_width + hull.half_height).mean(axis=1)
    return np.asarray(0.5 * WATER_KG_M3 * around * hull.length * outside["rough"])


def points_of(robot: Robot, hull: Hull, surface_m: float) -> Array:
    """Points at which the appendages resist, shape (L, P, 4), with P at least 1.

    Distance behind the start of the link's axis, behind the nose, and to the left of it in m, and
    drag along and across the link in N s2/m2. The last point of each link is unused, for
    the area that the file lacks. ``surface_m`` is the surface's height above the hull's middle.
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
    """Added mass of the appendages of each link at the start of its axis, shape (L, 3, 3)."""
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


def area_sd(robot: Robot) -> float:
    """Relative standard deviation of the drag areas that the robot file states."""
    return area_error([one.wetted(np.inf) for one in robot.appendages])
