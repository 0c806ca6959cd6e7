"""The water of a robot: a window that moves with it, or the whole pool with its walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.lattice.cell import SLIP, SOLID
from sim2real.arrays import Integers, Picture

WINDOW_M = (1.5, 1.0, 0.4)
POOL_M = (3.6, 3.6, 0.4)
"""The pool of Lin, Liu, Wang (2024): length, width, depth of the water."""
_UP = 4


@dataclass(frozen=True)
class Tank:
    """Cells and walls of one box.

    Attributes:
        size: Cells (nx, ny, nz), walls included; nz is 1 in two dimensions.
        walls: Kind of each cell, shape ``size``.
        normals: Direction out of the fluid at the free surface, shape ``size``.
        sponge: Width in cells of the absorbing layer; 0 where walls close the box.
    """

    size: tuple[int, int, int]
    walls: Picture
    normals: Integers
    sponge: int


def window(box_m: tuple[float, float, float], cell_m: float, *, flat: bool = False) -> Tank:
    """A box that follows the robot: periodic sides, water at rest far from the robot.

    Its bottom is the pool's floor (no slip), its top the surface (free slip).
    """
    nx, ny = (max(8, round(side / cell_m)) for side in box_m[:2])
    return _tank(nx, ny, box_m[2], cell_m, flat, sponge=max(3, round(0.12 * min(nx, ny))))


def pool(box_m: tuple[float, float, float], cell_m: float, *, flat: bool = False) -> Tank:
    """The whole pool: four walls, floor and surface."""
    nx, ny = (round(side / cell_m) + 1 for side in box_m[:2])
    tank = _tank(nx, ny, box_m[2], cell_m, flat, sponge=0)
    tank.walls[0] = tank.walls[:, 0] = SOLID
    return tank


def _tank(nx: int, ny: int, depth_m: float, cell_m: float, flat: bool, sponge: int) -> Tank:
    """A box; one layer of wall cells closes two opposite sides, as the box is periodic."""
    nz = 1 if flat else round(depth_m / cell_m) + 1
    walls, normals = np.zeros((nx, ny, nz), np.uint8), np.zeros((nx, ny, nz), np.int32)
    if not flat:
        walls[:, :, 0], normals[:, :, 0] = SLIP, _UP  # the surface for cells below, the floor above
    return Tank((nx, ny, nz), walls, normals, sponge)
