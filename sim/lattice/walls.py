"""Boundary conditions at walls, applied to populations before they return.

A moving wall adds its momentum (Ladd, J. Fluid Mech. 271 (1994) 285). A free-slip wall reflects
populations within one step (Kruger et al. (2017), Sec. 5.3.7): after two, as at walls at rest, the
flow around ghost cells of a body that pierces the surface is unstable.
"""

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import warp as wp

from sim.lattice.cell import FLUID, KIND, SLIP, Box
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice, Velocity


def mirrors(lattice: Lattice) -> list[tuple[int, Velocity, Velocity, Velocity]]:
    """All reflections at free-slip walls, each between two cells of a wall or, with 0 last, at one.

    The direction out of the fluid, 0 to 5: +x, -x, +y, -y, +z, -z; two velocities with which
    populations arrive; the way from the cell at which the second arrives to that of the first.
    """
    exchanges, unit = [], np.eye(3, dtype=int)
    axes = range(lattice.dimensions)
    for axis, sign, along in product(axes, (1, -1), axes):
        aside = unit[along] * (along != axis)
        ways = (sign * unit[axis] + aside, sign * unit[axis] - aside, aside)
        one, two, across = (tuple(way.tolist()) for way in ways)
        exchanges.append((2 * axis + int(sign < 0), one, two, across))
    return exchanges


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
        """Free-slip cell k of box e; of the cells ``inside`` only fluid receives populations."""
        e, k = wp.tid()
        n = e * box.cells + listed[k]
        water = e * box.cells + inside[k]
        j = neighbours(n, int(box.flags[n]), box)
        for m in range(wp.static(len(exchanges))):
            if normal[k] == wp.static(exchanges[m][0]):
                other = n
                if wp.static(any(exchanges[m][3])):
                    other = j[wp.static(lattice.index(exchanges[m][3]) // 2)]
                if (int(box.flags[other]) & wp.static(KIND)) == wp.static(SLIP):
                    beside = other + water - n
                    one = slot(wp.static(lattice.index(exchanges[m][1])), other, water, box.t)
                    two = slot(wp.static(lattice.index(exchanges[m][2])), n, beside, box.t)
                    first = read(f, one[0], one[1], box.total)
                    second = read(f, two[0], two[1], box.total)
                    if (int(box.flags[beside]) & wp.static(KIND)) == wp.static(FLUID):
                        to = slot(wp.static(lattice.opposite(exchanges[m][2])), beside, n, box.t)
                        write(f, to[0], to[1], box.total, first)
                    if (int(box.flags[water]) & wp.static(KIND)) == wp.static(FLUID):
                        to = slot(wp.static(lattice.opposite(exchanges[m][1])), water, other, box.t)
                        write(f, to[0], to[1], box.total, second)

    @wp.kernel(enable_backward=False, module="unique")
    def walls(
        f: Stored, box: Box, listed: wp.array(dtype=wp.int32), velocity: wp.array(dtype=wp.vec3)
    ):
        """Moving cell k of box e, of those ``listed``."""
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
