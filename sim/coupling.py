"""Bodies into the fluid, and the fluid's answer out of it, by the share of each cell that is solid.

Direct forcing of the volume: within a step the fluid in a cell is brought to the body's velocity
by the solid share of the cell. Before that, each link learns what that would cost: the sums that
``multibody.advance`` needs to find the velocity at which body and fluid agree, so that the
exchange is implicit and a body as light as the fluid is stable. Sources: Uhlmann, J. Comput. Phys.
209 (2005) 448 (direct forcing); Kajishima et al., JSME Int. J. B 44 (2001) 526 (by the solid
share).
"""

from functools import cache
from typing import Any

import warp as wp

from sim.cell import BODY, FLUID, KIND, Box
from sim.lattice import Lattice
from sim.populations import populations
from sim.section import along, distance, position_on, solid_share

SUMS = 7
"""Sums of one link: k, k rx, k ry, k r2, k ux, k uy, k (rx uy - ry ux), where k is the fluid's
density times the solid share, r the place from the link's centre of mass, u the velocity."""
FIXED_POINT = float(2**32)
"""Sums are kept as integers, so that their order makes no difference."""
_MOST_SHARE = 0.99999


@cache
def cover_kernel(lattice: Lattice, storage: str, wide: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel that marks the cells a body covers and sums over them."""
    made = populations(lattice, storage, wide)
    Stored, load, neighbours, moments = made.Stored, made.load, made.neighbours, made.moments

    @wp.func
    def add(sums: wp.array3d(dtype=wp.int64), e: int, link: int, k: int, x: wp.float64) -> int:
        wp.atomic_add(sums, e, link, k, wp.int64(x * wp.float64(wp.static(FIXED_POINT))))
        return 0

    @wp.kernel(enable_backward=False, module="unique")
    def cover(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        side: int,
        low: int,
        high: int,
        middle: float,
        corner: wp.array(dtype=wp.vec4i),
        pose: wp.array2d(dtype=wp.vec4),
        centre: wp.array2d(dtype=wp.vec2),
        length: wp.array(dtype=wp.float32),
        half_width: wp.array(dtype=wp.vec3),
        half_height: wp.array(dtype=wp.vec3),
        solid: wp.array(dtype=wp.float32),
        sums: wp.array3d(dtype=wp.int64),
        stopped: wp.array(dtype=wp.int32),
    ):
        """One column of cells; ``corner`` is where each body's cells begin and how far they go."""
        e, column = wp.tid()
        across = column // side
        box_at = corner[e]
        if column % side >= box_at[2] or across >= box_at[3] or stopped[e] >= 0:
            return
        X = box_at[0] + column % side
        Y = box_at[1] + across
        nearest = float(1.0e9)
        link = int(0)
        off_axis = float(0.0)
        width = float(0.0)
        height = float(1.0)
        for k in range(length.shape[0]):
            at = position_on(float(X), float(Y), pose[e, k], length[k])
            wide = along(half_width[k], at[0])
            if at[1] - wide < nearest:
                nearest = at[1] - wide
                link = k
                off_axis = at[1]
                width = wide
                height = along(half_height[k], at[0])
        x = X % box.nx
        y = Y % box.ny
        if x < 0:
            x += box.nx
        if y < 0:
            y += box.ny
        rx = float(X) - centre[e, link][0]
        ry = float(Y) - centre[e, link][1]
        total = float(0.0)
        px = float(0.0)
        py = float(0.0)
        for z in range(low, high):
            n = e * box.cells + x + box.nx * (y + box.ny * z)
            flag = int(flags[n])
            if (flag & wp.static(KIND)) == wp.static(FLUID):
                share = float(0.0)
                if nearest < 2.0:
                    share = solid_share(distance(off_axis, float(z) - middle, width, height))
                if share > 0.0:
                    held = float(link) + wp.min(share, wp.static(_MOST_SHARE))
                    share = held - float(link)
                    solid[n] = held
                    flags[n] = wp.uint8(flag | wp.static(BODY))
                    m = moments(load(f, n, neighbours(n, flag, box), t, box.total))
                    total += share * (1.0 + m[0])
                    px += share * m[1]
                    py += share * m[2]
                elif (flag & wp.static(BODY)) != 0:
                    flags[n] = wp.uint8(flag - wp.static(BODY))
        if total > 0.0:
            share_sum = wp.float64(total)
            ax = wp.float64(rx)
            ay = wp.float64(ry)
            ux = wp.float64(px)
            uy = wp.float64(py)
            add(sums, e, link, 0, share_sum)
            add(sums, e, link, 1, share_sum * ax)
            add(sums, e, link, 2, share_sum * ay)
            add(sums, e, link, 3, share_sum * (ax * ax + ay * ay))
            add(sums, e, link, 4, ux)
            add(sums, e, link, 5, uy)
            add(sums, e, link, 6, ax * uy - ay * ux)

    return cover
