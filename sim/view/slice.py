"""The kernel that reads the velocity in one horizontal plane of a box."""

from functools import cache
from typing import Any

import warp as wp

from sim.lattice.cell import FLUID, KIND, Box
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice


@cache
def slice_kernel(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel for a lattice and width of memory."""
    pop = populations(lattice, wide)
    Stored, load, neighbours, moments = pop.Stored, pop.load, pop.neighbours, pop.moments

    @wp.kernel(enable_backward=False, module="unique")
    def velocity_in(f: Stored, box: Box, e: int, z: int, velocity: wp.array2d(dtype=wp.vec2)):
        """Velocity along x and y in the plane z of box e; 0 in walls."""
        x, y = wp.tid()
        n = e * box.cells + x + box.nx * (y + box.ny * z)
        flag = int(box.flags[n])
        velocity[x, y] = wp.vec2()
        if (flag & wp.static(KIND)) == wp.static(FLUID):
            m = moments(load(f, n, neighbours(n, flag, box), box))
            velocity[x, y] = wp.vec2(m[1], m[2]) / (1.0 + m[0])

    return velocity_in
