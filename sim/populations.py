"""Populations in memory: where they lie, how they move, and their moments.

They are stored once and in place (the esoteric pull): in each step a cell reads, and writes back
to, a set of slots that no other cell touches, so cells may run in any order, and a slot that no
cell owns sends back what arrived in it: a solid cell bounces back by being left alone. Source:
Lehmann, Computation 10 (2022) 92. Numbers stored are f - w, whose rounding error is that of the
deviation from rest: Skordos, Phys. Rev. E 48 (1993) 4823.

Symbols: n cell, counted through all boxes; t parity of the step; c velocity of a direction.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from sim.cell import EDGE, Box, place
from sim.lattice import Lattice

STORAGE = {"float32": (wp.float32, 1.0), "float16": (wp.float16, 512.0)}
"""Types of stored numbers, and the factor they are stored with.

Half precision then ends at the deviations that a fluid at a tenth of the speed of sound has.
Source: Lehmann et al., Phys. Rev. E 106 (2022) 015308.
"""


@dataclass(frozen=True)
class Populations:
    """Types and Warp functions for one lattice and storage type.

    Attributes:
        Stored: Type of the array in memory, Q rows of all cells one after the other.
        Vector: Type of one cell's populations, in single precision.
        neighbours: Cells that the odd directions point to from a cell.
        load: Populations that arrive at a cell.
        store: Send populations on from a cell.
        moments: Density less 1, and momentum.
        read, packed: Between a stored number and its value.
    """

    Stored: Any
    Vector: Any
    neighbours: Any
    load: Any
    store: Any
    moments: Any
    read: Any
    packed: Any


@cache
def populations(lattice: Lattice, storage: str) -> Populations:
    """The functions for a lattice; populations stored as ``float32`` or ``float16``."""
    c, pairs = lattice.velocities, lattice.pairs
    kind, scale = STORAGE[storage]
    Stored = wp.array(dtype=kind)
    Vector = wp.types.vector(length=lattice.Q, dtype=wp.float32)
    Cells = wp.types.vector(length=pairs, dtype=wp.int32)

    @wp.func
    def read(x: kind) -> float:
        return float(x) * wp.static(1.0 / scale)

    @wp.func
    def packed(x: float) -> kind:
        return kind(x * wp.static(scale))

    @wp.func
    def neighbours(n: int, flag: int, box: Box) -> Cells:
        right = int(1)
        left = int(-1)
        front = box.nx
        back = -box.nx
        up = box.nx * box.ny
        down = -up
        if (flag & wp.static(EDGE)) != 0:
            at = place(n, box)
            if at[0] == box.nx - 1:
                right -= box.nx
            if at[0] == 0:
                left += box.nx
            if at[1] == box.ny - 1:
                front -= box.nx * box.ny
            if at[1] == 0:
                back += box.nx * box.ny
            if at[2] == box.nz - 1:
                up -= box.cells
            if at[2] == 0:
                down += box.cells
        j = Cells()
        for k in range(wp.static(pairs)):
            i = n
            if wp.static(c[2 * k + 1][0] > 0):
                i += right
            if wp.static(c[2 * k + 1][0] < 0):
                i += left
            if wp.static(c[2 * k + 1][1] > 0):
                i += front
            if wp.static(c[2 * k + 1][1] < 0):
                i += back
            if wp.static(c[2 * k + 1][2] > 0):
                i += up
            if wp.static(c[2 * k + 1][2] < 0):
                i += down
            j[k] = i
        return j

    @wp.func
    def load(f: Stored, n: int, j: Cells, t: int, total: int) -> Vector:
        p = Vector()
        p[0] = read(f[n])
        for k in range(wp.static(pairs)):
            p[2 * k + 1] = read(f[(wp.static(2 * k + 2) - t) * total + n])
            p[2 * k + 2] = read(f[(wp.static(2 * k + 1) + t) * total + j[k]])
        return p

    @wp.func
    def store(f: Stored, n: int, j: Cells, t: int, total: int, p: Vector) -> int:
        f[n] = packed(p[0])
        for k in range(wp.static(pairs)):
            f[(wp.static(2 * k + 1) + t) * total + j[k]] = packed(p[2 * k + 1])
            f[(wp.static(2 * k + 2) - t) * total + n] = packed(p[2 * k + 2])
        return 0

    @wp.func
    def moments(p: Vector) -> wp.vec4:
        rho = p[0]
        mx = float(0.0)
        my = float(0.0)
        mz = float(0.0)
        for k in range(wp.static(pairs)):
            rho += p[2 * k + 1] + p[2 * k + 2]
            d = p[2 * k + 1] - p[2 * k + 2]
            if wp.static(c[2 * k + 1][0] != 0):
                mx += wp.static(float(c[2 * k + 1][0])) * d
            if wp.static(c[2 * k + 1][1] != 0):
                my += wp.static(float(c[2 * k + 1][1])) * d
            if wp.static(c[2 * k + 1][2] != 0):
                mz += wp.static(float(c[2 * k + 1][2])) * d
        return wp.vec4(rho, mx, my, mz)

    return Populations(Stored, Vector, neighbours, load, store, moments, read, packed)
