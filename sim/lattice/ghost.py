"""Ghost cells: water inside a body, set so that the water outside slips along its surface.

A cell whose centre lies inside a body sends populations at equilibrium towards each neighbour in
the water. Across the surface their velocity is the body's; along it, that with which the links of
the cell exchange no momentum, or, where the links do not determine it, that of the water ``REACH``
cells outside. By their density no mass passes but what the moving surface displaces; what ghost
cells send to each other has the density of the water outside. Sources: Tiwari and Vanka, Int. J.
Numer. Meth. Fluids 69 (2012) 481 (ghost cells in a lattice-Boltzmann method); Ladd, J. Fluid Mech.
271 (1994) 285 (links that displace what the surface displaces).
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from sim.lattice.cell import FLUID, GHOST, KIND, Box, within
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice

REACH = 0.5
"""Least distance in cells from the surface of the water that ghost cells continue."""
WEAK = 0.14
"""Variance of the velocities of a cell's links, in a direction along the surface, below which they
do not determine the water's velocity in it; on a plane it is 1/3. With less a spheroid has drag in
ideal fluid; with more it exchanges momentum with the water along its surface in every time step."""


@cache
def ghosts(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - a namespace of Warp functions
    """The functions for a lattice, by name."""
    w, Q, back = lattice.weights, lattice.Q, [lattice.opposite(c) for c in lattice.velocities]
    ways = [wp.vec3(*map(float, c)) for c in lattice.velocities]
    pop = populations(lattice, wide)
    Stored, Vector, load = pop.Stored, pop.Vector, pop.load
    neighbours, moments = pop.neighbours, pop.moments

    @wp.func
    def water_at(
        f: Stored, box: Box, e: int, x: float, y: float, z: float, otherwise: wp.vec4
    ) -> wp.vec4:
        """Linear in the cells around the point; ``otherwise`` where none of them is water."""
        x0 = int(wp.floor(x))
        y0 = int(wp.floor(y))
        z0 = int(wp.floor(z))
        total = wp.vec4()
        weight = float(0.0)
        corners = int(wp.static(2**lattice.dimensions))  # a variable: Warp unrolls constants
        for corner in range(corners):
            i = corner % 2
            k = (corner // 2) % 2
            m = corner // 4
            share = 1.0 - wp.abs(x - float(x0 + i))
            share *= 1.0 - wp.abs(y - float(y0 + k))
            if wp.static(lattice.dimensions == 3):
                share *= 1.0 - wp.abs(z - float(z0 + m))
            n = e * box.cells + within(x0 + i, box.nx) + box.nx * within(y0 + k, box.ny)
            n += box.nx * box.ny * within(z0 + m, box.nz)
            flag = int(box.flags[n])
            if share > 0.0 and (flag & wp.static(KIND | GHOST)) == wp.static(FLUID):
                u = moments(load(f, n, neighbours(n, flag, box), box))
                inverse = 1.0 / (1.0 + u[0])
                total += share * wp.vec4(u[0], inverse * u[1], inverse * u[2], inverse * u[3])
                weight += share
        if weight < 1.0e-3:
            return otherwise
        return total / weight

    @wp.func
    def emitted(
        p: Vector, links: int, face: wp.vec4, water: wp.vec4, across: float, leak: float
    ) -> Vector:
        """Populations for the body's velocity ``across`` the surface; linear in it.

        ``p`` arrive, ``face`` is the surface's normal and the density, ``water`` the velocity along
        it and, for terms of second order, across it; ``leak`` the density that the links lack so
        that no mass passes the whole surface.
        """
        rho = face[3]
        u = wp.vec3(
            water[0] + across * face[0], water[1] + across * face[1], water[2] + across * face[2]
        )
        before = wp.vec3(
            water[0] + water[3] * face[0],
            water[1] + water[3] * face[1],
            water[2] + water[3] * face[2],
        )
        still = 1.5 * wp.dot(before, before)
        out = Vector()
        passed = 0.0
        weight = 0.0
        for k in range(wp.static(Q)):
            q = wp.static(ways[k])
            odd = 3.0 * wp.dot(q, u)
            cu = wp.dot(q, before)
            even = 4.5 * cu * cu - still
            out[k] = wp.static(w[k]) * rho * (odd + even)
            if (links & wp.static(1 << k)) != 0:
                passed += p[wp.static(back[k])]
                passed += wp.static(w[k]) * rho * (odd - even)
                weight += wp.static(w[k])
        for k in range(wp.static(Q)):
            rest = rho - 1.0
            if (links & wp.static(1 << k)) != 0:
                rest = passed / weight - leak
            out[k] += wp.static(w[k]) * rest
        return out

    @wp.func
    def slipping(p: Vector, links: int, face: wp.vec4, water: wp.vec4) -> wp.vec4:
        """``water`` with the velocity along the surface that exchanges no momentum along it.

        The least-squares fit of an equilibrium to the populations that arrive through the links, of
        whose velocities' variance v the share v^2 / (v^2 + WEAK^2) counts (Tikhonov).
        """
        n = wp.vec3(face[0], face[1], face[2])
        rho = face[3]
        before = wp.vec3(water[0], water[1], water[2]) + water[3] * n
        still = 1.5 * wp.dot(before, before)
        weight = 0.0
        mean = wp.vec3()
        square = wp.mat33()
        excess = 0.0
        moment = wp.vec3()
        for k in range(wp.static(Q)):
            if (links & wp.static(1 << k)) != 0:
                q = wp.static(ways[k])
                cu = wp.dot(q, before)
                a = p[wp.static(back[k])]
                a += wp.static(w[k]) * rho * (3.0 * cu - 4.5 * cu * cu + still)
                weight += wp.static(w[k])
                mean += wp.static(w[k]) * q
                square += wp.static(w[k]) * wp.outer(q, q)
                excess += a
                moment += a * q
        if weight == 0.0:
            return water
        mean = mean / weight
        square = square / weight - wp.outer(mean, mean)
        moment = moment / weight - (excess / weight) * mean
        flat = wp.identity(n=3, dtype=wp.float32) - wp.outer(n, n)
        spread = flat * square * flat + wp.outer(n, n)
        whole = spread * spread + wp.static(WEAK * WEAK) * flat
        change = (wp.inverse(whole) * (spread * (flat * moment))) / (3.0 * rho)
        return water - wp.vec4(change[0], change[1], change[2], 0.0)

    @wp.func
    def passing(links: int, face: wp.vec4, water: wp.vec4) -> wp.vec2:
        """Mass that a cell's links bring into the water in a step, and the sum of their weights."""
        u = wp.vec3(water[0], water[1], water[2])
        u += water[3] * wp.vec3(face[0], face[1], face[2])
        out = wp.vec2()
        for k in range(wp.static(Q)):
            if (links & wp.static(1 << k)) != 0:
                q = wp.static(ways[k])
                out += wp.static(w[k]) * wp.vec2(6.0 * face[3] * wp.dot(q, u), 1.0)
        return out

    @wp.func
    def positive(p: Vector, links: int, face: wp.vec4, water: wp.vec4) -> wp.vec4:
        """``face`` with the largest density for which no population that is sent is negative."""
        u = wp.vec3(water[0], water[1], water[2])
        u += water[3] * wp.vec3(face[0], face[1], face[2])
        still = 1.5 * wp.dot(u, u)
        arrived = float(0.0)
        displaced = float(0.0)
        weight = float(0.0)
        least = float(0.0)
        for k in range(wp.static(Q)):
            if (links & wp.static(1 << k)) != 0:
                q = wp.static(ways[k])
                cu = wp.dot(q, u)
                even = 4.5 * cu * cu - still
                arrived += p[wp.static(back[k])]
                displaced += wp.static(w[k]) * (3.0 * cu - even)
                weight += wp.static(w[k])
                least = wp.min(least, 3.0 * cu + even)
        if weight == 0.0:
            return face
        least += displaced / weight
        rho = face[3]
        if least < 0.0:
            rho = wp.min(rho, wp.max(1.0 + arrived / weight, 0.0) / -least)
        return wp.vec4(face[0], face[1], face[2], rho)

    @wp.func
    def sent(p: Vector, links: int, others: int, face: wp.vec4, water: wp.vec4, leak: float):
        """Momentum in the plane of what ``emitted`` returns for the velocity across in ``water``.

        Of the populations along ``links``, and of those along neither ``links`` nor ``others``:
        each the momentum (x, y) and its derivative by the velocity across (x, y).
        """
        rho = face[3]
        n = wp.vec3(face[0], face[1], face[2])
        u = wp.vec3(water[0], water[1], water[2]) + water[3] * n
        still = 1.5 * wp.dot(u, u)
        through = wp.vec4()
        among = wp.vec4()
        mean = wp.vec2()
        weight = float(0.0)
        passed = float(0.0)
        rate = float(0.0)
        for k in range(wp.static(Q)):
            q = wp.static(ways[k])
            cu = wp.dot(q, u)
            odd = wp.static(3.0 * w[k]) * rho * cu
            even = wp.static(w[k]) * rho * (4.5 * cu * cu - still)
            slope = wp.static(3.0 * w[k]) * rho * wp.dot(q, n)
            if (links & wp.static(1 << k)) != 0:
                passed += p[wp.static(back[k])] + odd - even
                rate += slope
                weight += wp.static(w[k])
                mean += wp.static(w[k]) * wp.vec2(q[0], q[1])
                out = odd + even
                through += wp.vec4(out * q[0], out * q[1], slope * q[0], slope * q[1])
            elif (others & wp.static(1 << k)) == 0:
                out = odd + even + wp.static(w[k]) * (rho - 1.0)
                among += wp.vec4(out * q[0], out * q[1], slope * q[0], slope * q[1])
        if weight > 0.0:
            rest = passed / weight - leak
            rate /= weight
            through += wp.vec4(rest * mean[0], rest * mean[1], rate * mean[0], rate * mean[1])
        return through, among

    return SimpleNamespace(
        water_at=water_at, emitted=emitted, sent=sent, slipping=slipping, passing=passing,
        positive=positive,
    )  # fmt: skip
