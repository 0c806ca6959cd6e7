"""Boundary conditions at walls, applied to populations before they return.

A moving wall adds its momentum (Ladd, J. Fluid Mech. 271 (1994) 285). A free-slip wall reflects
populations within one step (Kruger et al. (2017), Sec. 5.3.7): after two, as at walls at rest, the
flow around ghost cells of a body that pierces the surface is unstable.
"""

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import warp as wp

from sim.lattice.cell import FLUID, KIND, SLIP, Box
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice

Velocity = tuple[int, int, int]


@dataclass(frozen=True)
class Mirror:
    """One reflection at a free-slip wall, between two of its cells or, with 0 across, at one."""

    normal: int  # direction out of the fluid, 0 to 5: +x, -x, +y, -y, +z, -z
    # one, two: velocities with which populations arrive at the wall
    one: Velocity
    two: Velocity
    across: Velocity  # from the cell at which ``two`` arrives to that of ``one``


def mirrors(lattice: Lattice) -> tuple[Mirror, ...]:
    """All reflections."""
    exchanges = []
    axes = range(lattice.dimensions)
    for axis, sign, along in product(axes, (1, -1), axes):
        first, second, across = [0, 0, 0], [0, 0, 0], [0, 0, 0]
        first[axis] = second[axis] = sign
        if along != axis:
            first[along], second[along], across[along] = 1, -1, 1
        normal = 2 * axis + int(sign < 0)
        exchanges.append(Mirror(normal, _velocity(first), _velocity(second), _velocity(across)))
    return tuple(exchanges)


def _velocity(x: list[int]) -> Velocity:
    return x[0], x[1], x[2]


@cache
def wall_kernels(lattice: Lattice, wide: bool) -> tuple[Any, Any]:
    """Kernels for free-slip walls and for those that move."""
    c, w, pairs = lattice.velocities, lattice.weights, lattice.pairs
    pop = populations(lattice, wide)
    Stored, Vector, read, write = pop.Stored, pop.Vector, pop.read, pop.write
    neighbours, load, store = pop.neighbours, pop.load, pop.store
    exchanges = mirrors(lattice)

    @wp.func
    def slot(d: int, n: int, source: int, t: int) -> wp.vec2i:
        """Row and cell of the population that arrives at n along direction d from ``source``."""
        if d % 2 == 0:
            return wp.vec2i(d - 1 + t, source)
        return wp.vec2i(d + 1 - t, n)

    @wp.kernel(enable_backward=False, module="unique")
    def mirror(
        f: Stored,
        box: Box,
        listed: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=wp.int32),
        inside: wp.array(dtype=wp.int32),
    ):
        """Free-slip cell k of box e; ``listed`` are the cells, counted in one box.

        ``inside`` are the cells before them, of which only fluid cells receive populations.
        """
        e, k = wp.tid()
        n = e * box.cells + listed[k]
        water = e * box.cells + inside[k]
        j = neighbours(n, int(box.flags[n]), box)
        for m in range(wp.static(len(exchanges))):
            if normal[k] == wp.static(exchanges[m].normal):
                other = n
                if wp.static(any(exchanges[m].across)):
                    other = j[wp.static(lattice.index(exchanges[m].across) // 2)]
                if (int(box.flags[other]) & wp.static(KIND)) == wp.static(SLIP):
                    beside = other + water - n
                    one = slot(wp.static(lattice.index(exchanges[m].one)), other, water, box.t)
                    two = slot(wp.static(lattice.index(exchanges[m].two)), n, beside, box.t)
                    first = read(f, one[0], one[1], box.total)
                    second = read(f, two[0], two[1], box.total)
                    if (int(box.flags[beside]) & wp.static(KIND)) == wp.static(FLUID):
                        to = slot(wp.static(lattice.opposite(exchanges[m].two)), beside, n, box.t)
                        write(f, to[0], to[1], box.total, first)
                    if (int(box.flags[water]) & wp.static(KIND)) == wp.static(FLUID):
                        to = slot(
                            wp.static(lattice.opposite(exchanges[m].one)), water, other, box.t
                        )
                        write(f, to[0], to[1], box.total, second)

    @wp.kernel(enable_backward=False, module="unique")
    def walls(
        f: Stored, box: Box, listed: wp.array(dtype=wp.int32), velocity: wp.array(dtype=wp.vec3)
    ):
        """Moving cell k of box e; ``listed`` are the cells, counted in one box."""
        e, k = wp.tid()
        n = e * box.cells + listed[k]
        u = velocity[k]
        j = neighbours(n, int(box.flags[n]), box)
        p = load(f, n, j, box)
        out = Vector()
        out[0] = p[0]
        for d in range(wp.static(pairs)):
            cu = (
                wp.static(float(c[2 * d + 1][0])) * u[0]
                + wp.static(float(c[2 * d + 1][1])) * u[1]
                + wp.static(float(c[2 * d + 1][2])) * u[2]
            )
            a = p[2 * d + 1]
            b = p[2 * d + 2]
            odd = wp.static(3.0 * w[2 * d + 1]) * cu
            out[2 * d + 1] = b + 2.0 * odd
            out[2 * d + 2] = a - 2.0 * odd
        store(f, n, j, box, out)

    return mirror, walls
