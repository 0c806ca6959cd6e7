"""Populations: their layout in memory, their streaming, and their moments.

They are stored once and in place (the esoteric pull: Lehmann, Computation 10 (2022) 92); slots of
solid cells return the populations that arrive: bounce-back. The stored numbers are f - w (Skordos,
Phys. Rev. E 48 (1993) 4823). From 2^31 slots on memory is wide: (Q, cells), whose offsets Warp
computes in 64 bits. Symbols: n cell, counted through all boxes; row one of the Q slots of a cell; t
parity of the step; c velocity.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from sim.lattice.cell import EDGE, Box, place
from sim.lattice.velocities import Lattice

WIDE_FROM = 2**31
"""Number of slots from which on memory is wide."""
FIXED_POINT = float(2**32)
"""Scale of sums over cells, which are integers so that their order makes no difference."""
MOST_CELLS = (2**31 - 1) // 4
"""Largest number of cells of a batch: Warp's strides have 32 bits, a row of wide memory 4 bytes for
each cell."""


def is_wide(lattice: Lattice, cells: int) -> bool:
    """Whether a batch with this number of cells needs wide memory."""
    return lattice.Q * cells >= WIDE_FROM


def allocate(lattice: Lattice, wide: bool, cells: int, device: Any) -> Any:  # noqa: ANN401
    """Memory for the populations of a number of cells, filled with water at rest."""
    shape = (lattice.Q, cells) if wide else lattice.Q * cells
    return wp.zeros(shape, dtype=wp.float32, device=device)


@cache
def populations(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - a namespace of Warp's types and functions
    """``Stored``, the type of the memory, ``Vector`` of a cell's populations, and functions.

    ``neighbours`` are the cells in the odd directions; ``load`` and ``store`` the populations that
    arrive and leave; ``moments`` density minus 1 and momentum; ``read`` and ``write`` one slot.
    """
    c, pairs = lattice.velocities, lattice.pairs
    Stored = wp.array2d(dtype=wp.float32) if wide else wp.array(dtype=wp.float32)
    Vector = wp.types.vector(length=lattice.Q, dtype=wp.float32)
    Cells = wp.types.vector(length=pairs, dtype=wp.int32)

    @wp.func
    def read(f: Stored, row: int, n: int, total: int) -> float:
        if wp.static(wide):
            return f[row, n]
        else:
            return f[row * total + n]

    @wp.func
    def write(f: Stored, row: int, n: int, total: int, x: float):
        if wp.static(wide):
            f[row, n] = x
        else:
            f[row * total + n] = x

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
    def load(f: Stored, n: int, j: Cells, box: Box) -> Vector:
        p = Vector()
        p[0] = read(f, 0, n, box.total)
        for k in range(wp.static(pairs)):
            p[2 * k + 1] = read(f, wp.static(2 * k + 2) - box.t, n, box.total)
            p[2 * k + 2] = read(f, wp.static(2 * k + 1) + box.t, j[k], box.total)
        return p

    @wp.func
    def store(f: Stored, n: int, j: Cells, box: Box, p: Vector) -> None:
        write(f, 0, n, box.total, p[0])
        for k in range(wp.static(pairs)):
            write(f, wp.static(2 * k + 1) + box.t, j[k], box.total, p[2 * k + 1])
            write(f, wp.static(2 * k + 2) - box.t, n, box.total, p[2 * k + 2])

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

    return SimpleNamespace(
        Stored=Stored, Vector=Vector, neighbours=neighbours, load=load, store=store,
        moments=moments, read=read, write=write,
    )  # fmt: skip
