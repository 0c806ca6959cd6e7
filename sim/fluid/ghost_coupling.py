"""Coupling of bodies and fluid by ghost cells (``ghost``), implicit in the bodies' velocity.

What ghost cells send to the water is linear in the body's velocity, and its sums over each link are
those of ``coupling``: E v is part of what they send to the water, R v + b what they send to each
other, and a the rest of both less all that arrives in them. So momentum is conserved. The mass that
all links would bring into the water, as a mean over ``wall.MEMORY`` steps, is taken out again over
the surface. Friction acts on the water within a cell of the surface, in proportion to its area.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from sim.fluid.coupling import NEAR, add, add_matrix, add_vector, nearest_link
from sim.fluid.section import along, surface
from sim.fluid.wall import Touch, friction, layer_ratio
from sim.lattice.cell import (
    BODY,
    FLUID,
    GHOST,
    KIND,
    SLIP,
    Box,
    Covered,
    column_at,
    neighbour,
    rigid_velocity,
    slot_at,
)
from sim.lattice.ghost import REACH, ghosts
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice


@wp.func
def enlist(e: int, kind: int, cell: int, covered: Covered) -> None:
    """Add a cell of a body's square to its ghost cells (``kind`` 0) or those next to it (1)."""
    row = 2 * e + kind
    covered.listed[row, wp.atomic_add(covered.count, row, 1)] = cell


@wp.func
def listed_cell(e: int, kind: int, i: int, covered: Covered, box: Box):
    """Ghost cell ``i`` of a body (``kind`` 0) or one next to it (1), and its place and motion."""
    cell = covered.listed[2 * e + kind, i]
    base = column_at(e, cell // covered.tall, covered, box)
    z = covered.low + cell % covered.tall
    at = wp.vec4i(base[0], base[1], z, base[2] + box.nx * box.ny * z)
    slot = slot_at(e, cell, covered)
    link = int(covered.share[slot])
    r = wp.vec2(float(at[0]), float(at[1])) - covered.centre[e, link]
    return at, slot, link, r, rigid_velocity(covered.twist[e, link], r)


@cache
def ghost_kernels(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - a namespace of kernels
    """The kernels for a lattice, by name, in the order in which a step launches them."""
    pop, ghost = populations(lattice, wide), ghosts(lattice, wide)
    Stored, load = pop.Stored, pop.load
    neighbours, moments, store = pop.neighbours, pop.moments, pop.store
    water_at, emitted, sent = ghost.water_at, ghost.emitted, ghost.sent
    slipping, passing, positive = ghost.slipping, ghost.passing, ghost.positive
    c, Q = lattice.velocities, lattice.Q

    @wp.kernel(enable_backward=False, module="unique")
    def mark(box: Box, covered: Covered, touch: Touch):
        """Some layers of a column: depth and normal of cells inside a body and next to it."""
        e, part, column = wp.tid()
        base = column_at(e, column, covered, box)
        if base[2] < 0 or box.stopped[e] >= 0:
            return
        X = base[0]
        Y = base[1]
        floor = base[2]
        link, nearest, s, _off = nearest_link(float(X), float(Y), e, covered)
        rest = wp.vec2()
        for k in range(covered.length.shape[0]):
            if k < link:
                rest[0] += covered.length[k]
            if k > link:
                rest[1] += covered.length[k]
        first = part * covered.layers
        for layer in range(first, wp.min(first + covered.layers, covered.tall)):
            z = covered.low + layer
            n = floor + box.nx * box.ny * z
            flag = int(box.flags[n])
            if (flag & wp.static(KIND)) == wp.static(FLUID):
                flag = flag & wp.static(~(GHOST | BODY) & 255)
                if nearest < wp.static(NEAR):
                    height = float(z) - covered.middle
                    d, o, other = surface(
                        float(X), float(Y), height, e, link, covered, rest, touch.edge
                    )
                    cell = column * covered.tall + layer
                    slot = slot_at(e, cell, covered)
                    covered.share[slot] = float(link)
                    if d <= 0.0:
                        flag = flag | wp.static(GHOST)
                        covered.face[slot] = wp.vec4(o[0], o[1], o[2], -d)
                        covered.back[slot] = wp.vec4(0.0, 0.0, 0.0, other)
                        enlist(e, 0, cell, covered)
                    elif d <= 1.0:
                        flag = flag | wp.static(BODY)
                        axes = along(covered.half_width[link], s) + along(
                            covered.half_height[link], s
                        )
                        covered.face[slot] = wp.vec4(o[0], o[1], o[2], d)
                        covered.back[slot] = wp.vec4(0.0, 0.0, 0.0, axes / (axes + 2.0 * d))
                        enlist(e, 1, cell, covered)
                box.flags[n] = wp.uint8(flag)

    @wp.func
    def continued(
        f: Stored, box: Box, e: int, at: wp.vec3, n: wp.vec3, depth: float, body: wp.vec3
    ):
        """Normal and density, and velocities, of the water that a ghost cell continues."""
        reach = depth + wp.max(depth, wp.static(REACH))
        found = water_at(
            f, box, e,
            at[0] + reach * n[0], at[1] + reach * n[1], at[2] + reach * n[2],
            wp.vec4(0.0, body[0], body[1], body[2]),
        )  # fmt: skip
        u = wp.vec3(found[1], found[2], found[3])
        u -= wp.dot(u, n) * n
        return wp.vec4(n[0], n[1], n[2], 1.0 + found[0]), wp.vec4(u[0], u[1], u[2], wp.dot(body, n))

    @wp.kernel(enable_backward=False, module="unique")
    def shear(
        f: Stored, box: Box, covered: Covered, touch: Touch, rough: wp.array2d(dtype=wp.float64)
    ):
        """Friction in one thread's share of the listed cells next to a body."""
        e, lane = wp.tid()
        if box.stopped[e] >= 0:
            return
        for i in range(lane, covered.count[2 * e + 1], covered.lanes):
            at, slot, link, r, body = listed_cell(e, 1, i, covered, box)
            n = at[3]
            m = moments(load(f, n, neighbours(n, int(box.flags[n]), box), box))
            face = covered.face[slot]
            o = wp.vec3(face[0], face[1], face[2])
            u = wp.vec3(m[1], m[2], m[3]) / (1.0 + m[0])
            sliding = body - u - wp.dot(body - u, o) * o
            slip = wp.length(sliding)
            faster = layer_ratio(slip, face[3], touch)
            share = friction(faster * slip, float(rough[e, link]), touch)
            share *= faster * covered.back[slot][3]
            covered.face[slot] = wp.vec4(o[0], o[1], o[2], share)
            even = share * (1.0 + m[0])
            u -= wp.dot(u, o) * o
            add_matrix(
                covered.sums, e, link, 0, r,
                even * wp.mat22(1.0 - o[0] * o[0], -o[0] * o[1], -o[0] * o[1], 1.0 - o[1] * o[1]),
            )  # fmt: skip
            add_vector(covered.sums, e, link, 18, r, -even * wp.vec2(u[0], u[1]))

    @wp.func
    def water_links(n: int, box: Box, thin: bool, off: float, lateral: wp.vec3) -> wp.vec2i:
        """Bits of the directions in which a ghost cell has water, at its side and the other."""
        near = int(0)
        far = int(0)
        for k in range(1, wp.static(Q)):
            x = wp.static(c[k][0])
            y = wp.static(c[k][1])
            beside = int(box.flags[neighbour(n, x, y, wp.static(c[k][2]), box)])
            if (beside & wp.static(KIND)) == wp.static(SLIP):  # the surface reflects
                beside = int(box.flags[neighbour(n, x, y, 0, box)])
            if (beside & wp.static(KIND | GHOST)) == wp.static(FLUID):
                across = off + float(x) * lateral[0] + float(y) * lateral[1]
                if thin and across * off < 0.0:
                    far = far | wp.static(1 << k)
                else:
                    near = near | wp.static(1 << k)
        return wp.vec2i(near, far)

    @wp.kernel(enable_backward=False, module="unique")
    def cover(f: Stored, box: Box, covered: Covered):
        """Momentum and mass that one thread's share of a body's ghost cells exchange."""
        e, lane = wp.tid()
        if box.stopped[e] >= 0:
            return
        for i in range(lane, covered.count[2 * e], covered.lanes):
            place, slot, link, r, body = listed_cell(e, 0, i, covered, box)
            at = wp.vec3(float(place[0]), float(place[1]), float(place[2]))
            n = place[3]
            leak = covered.kept[e]
            head = covered.pose[e, link]
            lateral = wp.vec3(-head[3], head[2], 0.0)
            off = wp.dot(wp.vec3(at[0] - head[0], at[1] - head[1], 0.0), lateral)
            flag = int(box.flags[n])
            other = covered.back[slot][3]
            links = water_links(n, box, other > 0.0, off, lateral)
            covered.links[slot] = links
            covered.leak[slot] = leak
            face = covered.face[slot]
            o = wp.vec3(face[0], face[1], face[2])
            depth = face[3]
            sends = wp.mat22()
            keeps = wp.mat22()
            given = wp.vec2()
            held = wp.vec2()
            passed = wp.vec2()
            sides = int(1)
            if links[1] != 0:
                sides = 2
            for side in range(sides):
                if side == 1:
                    o -= 2.0 * wp.dot(o, lateral) * lateral
                    depth = other
                facing, water = continued(f, box, e, at, o, depth, body)
                p = load(f, n, neighbours(n, flag, box), box)
                water = slipping(p, links[side], facing, water)
                facing = positive(p, links[side], facing, water)
                passed += passing(links[side], facing, water)
                through, among = sent(p, links[side], links[1 - side], facing, water, leak)
                across = wp.vec2(o[0], o[1])
                slope = wp.vec2(through[2], through[3])
                sends += wp.outer(slope, across)
                given += wp.vec2(through[0], through[1]) - water[3] * slope
                if side == 0:
                    covered.face[slot] = facing
                    covered.water[slot] = water
                    slope = wp.vec2(among[2], among[3])
                    keeps = wp.outer(slope, across)
                    held = wp.vec2(among[0], among[1]) - water[3] * slope
                    m = moments(p)
                    given -= wp.vec2(m[1], m[2])
                else:
                    covered.back[slot] = facing
                    covered.beyond[slot] = water
            add_matrix(covered.sums, e, link, 0, r, sends)
            add_vector(covered.sums, e, link, 18, r, given + held)
            add_matrix(covered.sums, e, link, 9, r, keeps)
            add_vector(covered.sums, e, link, 21, r, held)
            add(covered.sums, e, link, 24, wp.float64(passed[0]))
            add(covered.sums, e, link, 25, wp.float64(passed[1]))

    @wp.kernel(enable_backward=False, module="unique")
    def emit(f: Stored, box: Box, covered: Covered):
        """Store what one thread's share of a body's ghost cells send out, as ``cover`` set it."""
        e, lane = wp.tid()
        if box.stopped[e] >= 0:
            return
        for i in range(lane, covered.count[2 * e], covered.lanes):
            at, slot, link, r, body = listed_cell(e, 0, i, covered, box)
            n = at[3]
            j = neighbours(n, int(box.flags[n]), box)
            p = load(f, n, j, box)
            links = covered.links[slot]
            face = covered.face[slot]
            across = wp.dot(body, wp.vec3(face[0], face[1], face[2]))
            leak = covered.leak[slot]
            out = emitted(p, links[0], face, covered.water[slot], across, leak)
            if links[1] != 0:
                face = covered.back[slot]
                across = wp.dot(body, wp.vec3(face[0], face[1], face[2]))
                beyond = emitted(p, links[1], face, covered.beyond[slot], across, leak)
                for k in range(wp.static(Q)):
                    if (links[1] & wp.static(1 << k)) != 0:
                        out[k] = beyond[k]
            store(f, n, j, box, out)

    return SimpleNamespace(mark=mark, shear=shear, cover=cover, emit=emit)
