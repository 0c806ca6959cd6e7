"""Coupling of bodies and fluid by the solid share of each cell, where the water does not slip.

The velocity of the fluid in a cell is set to the body's in proportion to the solid share of the
cell; the impulses of this forcing are summed for each link before, so that the exchange is implicit
(``multibody.advance``). Sources: Uhlmann, J. Comput. Phys. 209 (2005) 448 (direct forcing);
Kajishima et al., JSME Int. J. B 44 (2001) 526 (by the solid share).
"""

from functools import cache
from typing import Any

import warp as wp

from sim.fluid.section import along, distance, position_on, solid_share
from sim.lattice.cell import BODY, FLUID, KIND, Box, Covered, column_at, slot_at
from sim.lattice.populations import FIXED_POINT, populations
from sim.lattice.velocities import Lattice

SUMS = 26
"""Sums of one link. In a step all water receives from it the momentum (E + R) v + a, where v are
the body's velocities, and the water inside it then has R v + b; the rest acts on the link. E and R
are matrices (9 each, by rows), a and b vectors (x, y and the moment). By forcing, a covered cell of
density rho, solid share c and velocity u gets c (v - u): E sums c rho, a sums -c rho u; the others
are those of ghost cells (``ghost_coupling``). The last two are the mass that passes the surface in
a step, and the weight of the links through which it passes."""
_MOST_SHARE = 0.99999
NEAR = 3.0
"""Distance in cells from a link's outline within which a column of cells is processed."""


@wp.func
def add(sums: wp.array3d(dtype=wp.int64), e: int, link: int, k: int, x: wp.float64) -> None:
    """Add to one sum of a link."""
    wp.atomic_add(sums, e, link, k, wp.int64(x * wp.float64(wp.static(FIXED_POINT))))


@wp.func
def add_matrix(
    sums: wp.array3d(dtype=wp.int64), e: int, link: int, at: int, r: wp.vec2, k: wp.mat22
) -> None:
    """Add G' k G, where G leads from the link's twist to the velocity at r from its centre."""
    ax = wp.float64(r[0])
    ay = wp.float64(r[1])
    xx = wp.float64(k[0, 0])
    xy = wp.float64(k[0, 1])
    yx = wp.float64(k[1, 0])
    yy = wp.float64(k[1, 1])
    xw = ax * xy - ay * xx
    yw = ax * yy - ay * yx
    add(sums, e, link, at, xx)
    add(sums, e, link, at + 1, xy)
    add(sums, e, link, at + 2, xw)
    add(sums, e, link, at + 3, yx)
    add(sums, e, link, at + 4, yy)
    add(sums, e, link, at + 5, yw)
    add(sums, e, link, at + 6, ax * yx - ay * xx)
    add(sums, e, link, at + 7, ax * yy - ay * xy)
    add(sums, e, link, at + 8, ay * ay * xx - ax * ay * (xy + yx) + ax * ax * yy)


@wp.func
def add_vector(
    sums: wp.array3d(dtype=wp.int64), e: int, link: int, at: int, r: wp.vec2, p: wp.vec2
) -> None:
    """Add G' p: a momentum at r and its moment."""
    x = wp.float64(p[0])
    y = wp.float64(p[1])
    add(sums, e, link, at, x)
    add(sums, e, link, at + 1, y)
    add(sums, e, link, at + 2, wp.float64(r[0]) * y - wp.float64(r[1]) * x)


@wp.func
def nearest_link(x: float, y: float, e: int, covered: Covered):
    """The link nearest in plan view, distance from its outline, share along and way off it."""
    nearest = float(1.0e9)
    link = int(0)
    share = float(0.0)
    off_axis = float(0.0)
    for k in range(covered.length.shape[0]):
        at = position_on(x, y, covered.pose[e, k], covered.length[k])
        wide = along(covered.half_width[k], at[0])
        if at[1] - wide < nearest:
            nearest = at[1] - wide
            link = k
            share = at[0]
            off_axis = at[1]
    return link, nearest, share, off_axis


@cache
def cover_kernel(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel that marks the cells a body covers and sums over them."""
    pop = populations(lattice, wide)
    Stored, load, neighbours, moments = pop.Stored, pop.load, pop.neighbours, pop.moments

    @wp.kernel(enable_backward=False, module="unique")
    def cover(f: Stored, box: Box, covered: Covered):
        """One column of cells."""
        e, column = wp.tid()
        base = column_at(e, column, covered, box)
        if base[2] < 0 or box.stopped[e] >= 0:
            return
        X = base[0]
        Y = base[1]
        floor = base[2]
        link, nearest, s, off_axis = nearest_link(float(X), float(Y), e, covered)
        width = along(covered.half_width[link], s)
        height = along(covered.half_height[link], s)
        r = wp.vec2(float(X), float(Y)) - covered.centre[e, link]
        touched = bool(False)
        pull = float(0.0)
        forcing = wp.vec2()
        for layer in range(covered.tall):
            z = covered.low + layer
            n = floor + box.nx * box.ny * z
            flag = int(box.flags[n])
            if (flag & wp.static(KIND)) == wp.static(FLUID):
                share = float(0.0)
                if nearest < wp.static(NEAR):
                    share = solid_share(
                        distance(off_axis, float(z) - covered.middle, width, height)
                    )
                if share > 0.0:
                    held = float(link) + wp.min(share, wp.static(_MOST_SHARE))
                    share = held - float(link)
                    box.flags[n] = wp.uint8(flag | wp.static(BODY))
                    m = moments(load(f, n, neighbours(n, flag, box), box))
                    rho = 1.0 + m[0]
                    u = wp.vec3(m[1], m[2], m[3]) / rho
                    slot = slot_at(e, column * covered.tall + layer, covered)
                    covered.share[slot] = held
                    covered.face[slot] = wp.vec4(0.0, 0.0, 0.0, share)
                    pull += rho * share
                    forcing -= rho * share * wp.vec2(u[0], u[1])
                    touched = bool(True)
                elif (flag & wp.static(BODY)) != 0:
                    box.flags[n] = wp.uint8(flag - wp.static(BODY))
        if touched:
            add_matrix(covered.sums, e, link, 0, r, wp.mat22(pull, 0.0, 0.0, pull))
            add_vector(covered.sums, e, link, 18, r, forcing)

    return cover
