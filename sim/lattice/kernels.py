"""The fluid's Warp kernels: one source for every lattice and device."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from sim.lattice.cell import (
    BODY,
    FLUID,
    GHOST,
    KIND,
    Box,
    Covered,
    place,
    rigid_velocity,
    slot_at,
    within,
)
from sim.lattice.collision import collision
from sim.lattice.populations import FIXED_POINT, populations
from sim.lattice.velocities import Lattice

SUPERSONIC = 1 / 3
"""Square of the speed of sound in lattice units, beyond which the method is not valid."""
FAST = (1 - SUPERSONIC**0.5) ** 2
"""Square of the speed beyond which sound passes more than a cell in a step: cells relax wholly."""


@cache
def kernels(lattice: Lattice, wide: bool, cuda: bool) -> Any:  # noqa: ANN401 - a namespace of kernels
    """The kernels for a lattice, by name; on CUDA with its fast divisions and roots."""
    c, w, pairs = lattice.velocities, lattice.weights, lattice.pairs
    pop = populations(lattice, wide)
    Stored, Vector, read, write = pop.Stored, pop.Vector, pop.read, pop.write
    neighbours, load, store, moments = pop.neighbours, pop.load, pop.store, pop.moments
    subgrid_rates, relaxed, pushed = collision(lattice, wide)

    @wp.func
    def slot_of(n: int, e: int, box: Box, covered: Covered) -> wp.vec3i:
        """Place of a cell in the square around a body, and its coordinates in the plane."""
        at = place(n, box)
        corner = covered.corner[e]
        dx = within(at[0] - corner[0], box.nx)
        dy = within(at[1] - corner[1], box.ny)
        cell = (dy * covered.side + dx) * covered.tall + at[2] - covered.low
        return wp.vec3i(slot_at(e, cell, covered), corner[0] + dx, corner[1] + dy)

    @wp.func
    def body_velocity(at: wp.vec3i, e: int, covered: Covered) -> wp.vec3:
        """Velocity of the body in a cell that it covers."""
        link = int(covered.share[at[0]])
        r = wp.vec2(float(at[1]), float(at[2])) - covered.centre[e, link]
        return rigid_velocity(covered.twist[e, link], r)

    @wp.func
    def body_push(slot: int, lack: wp.vec3, covered: Covered) -> wp.vec3:
        """Change of velocity by the body where the water lacks this velocity."""
        face = covered.face[slot]
        o = wp.vec3(face[0], face[1], face[2])
        return face[3] * lack - face[3] * wp.dot(o, lack) * o

    @wp.kernel(
        enable_backward=False,
        module="unique",
        grid_stride=False,
        module_options={"fast_math": cuda},  # on a CPU this would remove the test for NaN
    )
    def step(
        f: Stored,
        box: Box,
        first: int,
        tau: wp.array(dtype=wp.float32),
        rates: wp.array(dtype=wp.vec2),
        magic: float,
        square: float,
        driven: int,
        drive: wp.array(dtype=wp.vec3),
        covered: Covered,
    ):
        """Collide and stream cell ``first`` + thread; ``square``: of Smagorinsky's constant."""
        n = first + wp.tid()
        flag = int(box.flags[n])
        if (flag & wp.static(KIND | GHOST)) != wp.static(FLUID):
            return
        e = int(0)
        if box.cells < box.total:
            e = n // box.cells
        halted = box.stopped[e]
        j = neighbours(n, flag, box)
        p = load(f, n, j, box)
        m4 = moments(p)
        rest = m4[0]
        m = wp.vec3(m4[1], m4[2], m4[3])
        inv = 1.0 / (1.0 + rest)
        rate = rates[e]
        damping = float(0.0)
        if (flag & wp.static(BODY)) != 0:
            damping = covered.damping
        if square > 0.0 or damping > 0.0:
            rate = subgrid_rates(p, rest, m, inv, tau[e], magic, square, damping)
        speed2 = wp.dot(m, m) * inv * inv
        if speed2 > wp.static(FAST):
            rate = wp.vec2(1.0, 1.0)
        out = relaxed(p, rest, m, inv, rate[0], rate[1])
        if (flag & wp.static(BODY)) + driven != 0:
            push = drive[e]
            if (flag & wp.static(BODY)) != 0:
                at = slot_of(n, e, box, covered)
                lack = body_velocity(at, e, covered) - inv * m
                push += body_push(at[0], lack, covered)
            out = pushed(out, 1.0 + rest, inv * m, push)
        if halted < 0:
            if not (speed2 < wp.static(SUPERSONIC)):
                box.stopped[e] = n - e * box.cells
            store(f, n, j, box, out)

    @wp.kernel(enable_backward=False, module="unique")
    def fields(
        f: Stored, box: Box, density: wp.array(dtype=wp.float32), velocity: wp.array(dtype=wp.vec3)
    ):
        """Density minus 1 and velocity of every fluid cell; 0 in walls."""
        n = wp.tid()
        flag = int(box.flags[n])
        density[n] = 0.0
        velocity[n] = wp.vec3()
        if (flag & wp.static(KIND)) == wp.static(FLUID):
            m = moments(load(f, n, neighbours(n, flag, box), box))
            density[n] = m[0]
            velocity[n] = wp.vec3(m[1], m[2], m[3]) / (1.0 + m[0])

    @wp.kernel(enable_backward=False, module="unique")
    def initialise(
        f: Stored,
        box: Box,
        tau: wp.array(dtype=wp.float32),
        density: wp.array(dtype=wp.float32),
        velocity: wp.array(dtype=wp.vec3),
        strain: wp.array2d(dtype=wp.float32),
    ):
        """Set arriving populations: equilibrium and strain's (Kruger et al. (2017), eq. 5.41)."""
        n = wp.tid()
        flag = int(box.flags[n])
        u = velocity[n]
        rho = 1.0 + density[n]
        p = Vector()
        uu = wp.dot(u, u)
        p[0] = wp.static(w[0]) * (density[n] - 1.5 * rho * uu)
        e = n // box.cells
        for k in range(wp.static(pairs)):
            x = wp.static(float(c[2 * k + 1][0]))
            y = wp.static(float(c[2 * k + 1][1]))
            z = wp.static(float(c[2 * k + 1][2]))
            cu = x * u[0] + y * u[1] + z * u[2]
            even = wp.static(w[2 * k + 1]) * (density[n] + rho * (4.5 * cu * cu - 1.5 * uu))
            if strain.shape[0] > 0:
                s = x * x * strain[n, 0] + y * y * strain[n, 1] + z * z * strain[n, 2]
                s += 2.0 * (x * y * strain[n, 3] + y * z * strain[n, 4] + z * x * strain[n, 5])
                even -= wp.static(3.0 * w[2 * k + 1]) * tau[e] * rho * s
            odd = wp.static(3.0 * w[2 * k + 1]) * rho * cu
            # A population that arrives is stored in the slot from which its opposite leaves.
            p[2 * k + 1] = even - odd
            p[2 * k + 2] = even + odd
        store(f, n, neighbours(n, flag, box), box, p)

    @wp.kernel(enable_backward=False, module="unique", grid_stride=False)
    def damp(
        f: Stored,
        box: Box,
        position: wp.array(dtype=wp.vec2),
        reach: wp.vec2,
        width: float,
        strength: float,
    ):
        """Damp the flow far from each box's robot: an absorbing layer that moves with it.

        Stored populations of water at rest are 0; a factor that falls with the square of the depth
        reflects little sound. All slots are read before one is written, so that reads do not wait.
        """
        n = wp.tid()
        e = n // box.cells
        at = place(n, box)
        dx = float(at[0]) - position[e][0]
        dy = float(at[1]) - position[e][1]
        dx = wp.abs(dx - float(box.nx) * wp.floor(dx / float(box.nx) + 0.5)) - reach[0]
        dy = wp.abs(dy - float(box.ny) * wp.floor(dy / float(box.ny) + 0.5)) - reach[1]
        depth = wp.max(dx, dy) / width
        if depth <= 0.0:
            return
        keep = 1.0 - strength * wp.min(depth * depth, 1.0)
        p = Vector()
        for d in range(wp.static(lattice.Q)):
            p[d] = read(f, d, n, box.total)
        for d in range(wp.static(lattice.Q)):
            write(f, d, n, box.total, keep * p[d])

    @wp.kernel(enable_backward=False, module="unique")
    def weigh(f: Stored, box: Box, excess: wp.array(dtype=wp.int64)):
        """Add one column of cells."""
        e, column = wp.tid()
        mass = wp.float64(0.0)
        for z in range(box.nz):
            n = e * box.cells + column + box.nx * box.ny * z
            flag = int(box.flags[n])
            if (flag & wp.static(KIND)) == wp.static(FLUID):
                m = moments(load(f, n, neighbours(n, flag, box), box))
                mass += wp.float64(m[0])
        wp.atomic_add(excess, e, wp.int64(mass * wp.float64(wp.static(FIXED_POINT))))

    @wp.kernel(enable_backward=False, module="unique")
    def level(f: Stored, box: Box, cells: int, excess: wp.array(dtype=wp.int64)):
        """Take each fluid cell's share from its population at rest, which has no momentum."""
        e, n = wp.tid()
        cell = e * box.cells + n
        if (int(box.flags[cell]) & wp.static(KIND)) == wp.static(FLUID):
            mass = wp.float64(excess[e]) / wp.float64(wp.static(FIXED_POINT))
            share = float(mass / wp.float64(cells))
            write(f, 0, cell, box.total, read(f, 0, cell, box.total) - share)

    return SimpleNamespace(
        step=step, fields=fields, initialise=initialise, damp=damp, weigh=weigh, level=level
    )
