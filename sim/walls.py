"""What walls do to the populations that arrive in them, before these turn back.

A moving wall adds its momentum (Ladd, J. Fluid Mech. 271 (1994) 285); a free-slip wall exchanges
its cells' populations along the wall, so that they leave as from a mirror; an outlet at density 1
turns them round by anti-bounce-back (Ginzburg et al., Commun. Comput. Phys. 3 (2008) 427). A wall
at rest needs nothing.
"""

from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import warp as wp

from sim.cell import KIND, MOVING, SLIP, Box, neighbour
from sim.lattice import Lattice
from sim.populations import populations


@dataclass(frozen=True)
class Mirror:
    """One exchange at a free-slip wall: directions ``one`` and ``two`` differ along ``across``."""

    normal: int
    one: tuple[int, int, int]
    two: tuple[int, int, int]
    across: tuple[int, int, int]


def mirrors(lattice: Lattice) -> tuple[Mirror, ...]:
    """All exchanges, for normals 0 to 5: +x, -x, +y, -y, +z, -z."""
    found = []
    axes = range(lattice.dimensions)
    for axis, sign, across in product(axes, (1, -1), axes):
        if across != axis:
            one, two, along = [0, 0, 0], [0, 0, 0], [0, 0, 0]
            one[axis] = two[axis] = sign
            one[across], two[across], along[across] = 1, -1, 1
            normal = 2 * axis + int(sign < 0)
            found.append(Mirror(normal, _triple(one), _triple(two), _triple(along)))
    return tuple(found)


def _triple(x: list[int]) -> tuple[int, int, int]:
    return x[0], x[1], x[2]


@cache
def wall_kernels(lattice: Lattice, storage: str) -> tuple[Any, Any]:
    """Kernels for walls, and for outlets' velocities."""
    c, w, pairs = lattice.velocities, lattice.weights, lattice.pairs
    made = populations(lattice, storage)
    Stored, Vector = made.Stored, made.Vector
    neighbours, load, store, moments = made.neighbours, made.load, made.store, made.moments
    exchanges = mirrors(lattice)

    @wp.func
    def slot(d: int, t: int, total: int) -> int:
        """Where the row of what arrives along direction d begins."""
        if d % 2 == 0:
            return (d - 1 + t) * total
        return (d + 1 - t) * total

    @wp.kernel(enable_backward=False, module="unique")
    def walls(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        listed: wp.array(dtype=wp.int32),
        normal: wp.array(dtype=wp.int32),
        velocity: wp.array(dtype=wp.vec3),
    ):
        """Wall cell k of box e; ``listed`` are the cells, counted in one box."""
        e, k = wp.tid()
        n = e * box.cells + listed[k]
        flag = int(flags[n])
        kind = flag & wp.static(KIND)
        if kind == wp.static(SLIP):
            for m in range(wp.static(len(exchanges))):
                if normal[k] == wp.static(exchanges[m].normal):
                    other = neighbour(
                        n,
                        wp.static(exchanges[m].across[0]),
                        wp.static(exchanges[m].across[1]),
                        wp.static(exchanges[m].across[2]),
                        box,
                    )
                    if (int(flags[other]) & wp.static(KIND)) == wp.static(SLIP):
                        # What arrives along an even direction lies in the cell it comes from.
                        one = wp.static(lattice.index(exchanges[m].one))
                        two = wp.static(lattice.index(exchanges[m].two))
                        at_two = n
                        at_one = other
                        if two % 2 == 0:
                            at_two = neighbour(
                                n,
                                wp.static(-exchanges[m].two[0]),
                                wp.static(-exchanges[m].two[1]),
                                wp.static(-exchanges[m].two[2]),
                                box,
                            )
                        if one % 2 == 0:
                            at_one = neighbour(
                                other,
                                wp.static(-exchanges[m].one[0]),
                                wp.static(-exchanges[m].one[1]),
                                wp.static(-exchanges[m].one[2]),
                                box,
                            )
                        at_two += slot(two, t, box.total)
                        at_one += slot(one, t, box.total)
                        held = f[at_two]
                        f[at_two] = f[at_one]
                        f[at_one] = held
            return
        u = velocity[k]
        j = neighbours(n, flag, box)
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
            if kind == wp.static(MOVING):
                kick = wp.static(6.0 * w[2 * d + 1]) * cu
                out[2 * d + 1] = b + kick
                out[2 * d + 2] = a - kick
            else:
                even = wp.static(2.0 * w[2 * d + 1]) * (4.5 * cu * cu - 1.5 * wp.dot(u, u))
                out[2 * d + 1] = even - b
                out[2 * d + 2] = even - a
        store(f, n, j, t, box.total, out)

    @wp.kernel(enable_backward=False, module="unique")
    def outlets(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        inside: wp.array(dtype=wp.int32),
        velocity: wp.array(dtype=wp.vec3),
    ):
        """Give outlet cells the velocity of the fluid cell before them, that of the first box."""
        k = wp.tid()
        n = inside[k]
        if n < 0:
            return
        m = moments(load(f, n, neighbours(n, int(flags[n]), box), t, box.total))
        velocity[k] = wp.vec3(m[1], m[2], m[3]) / (1.0 + m[0])

    return walls, outlets
