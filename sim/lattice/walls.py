"""Boundary conditions at walls, inlets and outlets, applied to populations before they return.

A moving wall adds its momentum (Ladd, J. Fluid Mech. 271 (1994) 285); a free-slip wall exchanges
its cells' populations along the wall, which is specular reflection. A wall at rest needs no kernel.

Openings send an equilibrium (bounce-back there is unstable at low viscosity): an inlet with its
velocity and the density of the cell before it, an outlet with the velocity of the cell before it
and a density of 1 plus net outflow over the speed of sound. That is the density of an outgoing
plane wave (Poinsot and Lele, J. Comput. Phys. 101 (1992) 104): with a fixed density the channel
would be an acoustic resonator, which a vortex street excites.
"""

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import warp as wp

from sim.lattice.cell import INLET, KIND, MOVING, SLIP, Box
from sim.lattice.populations import FIXED_POINT, populations
from sim.lattice.velocities import Lattice


@dataclass(frozen=True)
class Mirror:
    """One exchange at a free-slip wall: directions ``one`` and ``two`` differ along ``across``."""

    normal: int
    one: tuple[int, int, int]
    two: tuple[int, int, int]
    across: tuple[int, int, int]


def mirrors(lattice: Lattice) -> tuple[Mirror, ...]:
    """All exchanges, for normals 0 to 5: +x, -x, +y, -y, +z, -z."""
    exchanges = []
    axes = range(lattice.dimensions)
    for axis, sign, across in product(axes, (1, -1), axes):
        if across != axis:
            first, second, along = [0, 0, 0], [0, 0, 0], [0, 0, 0]
            first[axis] = second[axis] = sign
            first[across], second[across], along[across] = 1, -1, 1
            normal = 2 * axis + int(sign < 0)
            exchanges.append(Mirror(normal, _triple(first), _triple(second), _triple(along)))
    return tuple(exchanges)


def _triple(x: list[int]) -> tuple[int, int, int]:
    return x[0], x[1], x[2]


@cache
def wall_kernels(lattice: Lattice, storage: str, wide: bool) -> tuple[Any, Any]:
    """Kernels for walls, and for the flow through inlets and outlets."""
    c, w, pairs = lattice.velocities, lattice.weights, lattice.pairs
    pop = populations(lattice, storage, wide)
    Stored, Vector, read, write = pop.Stored, pop.Vector, pop.read, pop.write
    neighbours, load, store, moments = pop.neighbours, pop.load, pop.store, pop.moments
    exchanges = mirrors(lattice)

    @wp.func
    def row(d: int, t: int) -> int:
        """The row of the population that arrives along direction d."""
        if d % 2 == 0:
            return d - 1 + t
        return d + 1 - t

    @wp.kernel(enable_backward=False, module="unique")
    def walls(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        listed: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=wp.int32),
        velocity: wp.array(dtype=wp.vec3),
        through: wp.array2d(dtype=wp.vec4),
        excess: wp.array(dtype=wp.float32),
    ):
        """Wall cell k of box e; ``listed`` are the cells, counted in one box."""
        e, k = wp.tid()
        n = e * box.cells + listed[k]
        flag = int(flags[n])
        kind = flag & wp.static(KIND)
        j = neighbours(n, flag, box)
        if kind == wp.static(SLIP):
            for m in range(wp.static(len(exchanges))):
                if normal[k] == wp.static(exchanges[m].normal):
                    other = j[wp.static(lattice.index(exchanges[m].across) // 2)]
                    beyond = int(flags[other])
                    if (beyond & wp.static(KIND)) == wp.static(SLIP):
                        # Populations of even directions are stored in the cell that they come from.
                        one = wp.static(lattice.index(exchanges[m].one))
                        two = wp.static(lattice.index(exchanges[m].two))
                        at_two = n
                        at_one = other
                        if wp.static(lattice.index(exchanges[m].two) % 2 == 0):
                            at_two = j[wp.static(lattice.index(exchanges[m].two) // 2 - 1)]
                        if wp.static(lattice.index(exchanges[m].one) % 2 == 0):
                            around = neighbours(other, beyond, box)
                            at_one = around[wp.static(lattice.index(exchanges[m].one) // 2 - 1)]
                        row_one = row(one, t)
                        row_two = row(two, t)
                        held = read(f, row_two, at_two, box.total)
                        write(f, row_two, at_two, box.total, read(f, row_one, at_one, box.total))
                        write(f, row_one, at_one, box.total, held)
            return
        u = velocity[k]
        rest = float(0.0)
        if kind != wp.static(MOVING):
            sent = through[e, k]
            u = wp.vec3(sent[0], sent[1], sent[2])
            rest = sent[3]
            if kind != wp.static(INLET):
                rest = excess[e]
        p = load(f, n, j, t, box.total)
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
            if kind == wp.static(MOVING):
                out[2 * d + 1] = b + 2.0 * odd
                out[2 * d + 2] = a - 2.0 * odd
            else:
                bend = (1.0 + rest) * (4.5 * cu * cu - 1.5 * wp.dot(u, u))
                even = wp.static(w[2 * d + 1]) * (rest + bend)
                out[2 * d + 1] = even + (1.0 + rest) * odd
                out[2 * d + 2] = even - (1.0 + rest) * odd
        store(f, n, j, t, box.total, out)

    @wp.kernel(enable_backward=False, module="unique")
    def openings(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        listed: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=wp.int32),
        inside: wp.array(dtype=wp.int32),
        velocity: wp.array(dtype=wp.vec3),
        through: wp.array2d(dtype=wp.vec4),
        sums: wp.array(dtype=wp.int64),
    ):
        """Velocity at opening k of box e, and the density minus 1 where that is an inlet.

        ``inside`` are the fluid cells before the openings, negative where wall cell k is none;
        ``sums`` are the net outflows, as integers, so that their order makes no difference.
        """
        e, k = wp.tid()
        if inside[k] < 0:
            return
        n = e * box.cells + inside[k]
        m = moments(load(f, n, neighbours(n, int(flags[n]), box), t, box.total))
        u = velocity[k]
        if (int(flags[e * box.cells + listed[k]]) & wp.static(KIND)) != wp.static(INLET):
            u = wp.vec3(m[1], m[2], m[3]) / (1.0 + m[0])
        out = u[normal[k] // 2] * float(1 - 2 * (normal[k] % 2))
        wp.atomic_add(sums, e, wp.int64(wp.float64(out) * wp.float64(wp.static(FIXED_POINT))))
        through[e, k] = wp.vec4(u[0], u[1], u[2], m[0])

    return walls, openings


@wp.kernel(enable_backward=False)
def let_out(sums: wp.array(dtype=wp.int64), outlets: float, excess: wp.array(dtype=wp.float32)):
    """Density minus 1 at the ``outlets`` outlet cells of box e."""
    e = wp.tid()
    net = wp.float64(sums[e]) / wp.float64(wp.static(FIXED_POINT))
    sums[e] = wp.int64(0)
    excess[e] = wp.static(3.0**0.5) * float(net) / outlets
