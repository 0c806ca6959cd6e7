"""The fluid's Warp kernels: one source for every lattice, storage type and device.

Populations are stored once and in place (the esoteric pull): in each step a cell reads, and writes
back to, a set of slots that no other cell touches, so cells may run in any order and a slot that no
cell owns sends back what arrived in it: a solid cell bounces back by being left alone. Source:
Lehmann, Computation 10 (2022) 92. Numbers stored are f - w, whose rounding error is that of the
deviation from rest: Skordos, Phys. Rev. E 48 (1993) 4823.

Symbols: n cell, counted through all boxes; t parity of the step; u velocity and rho density in
lattice units; c velocity of a direction, w its weight.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from sim.lattice import Lattice

FLUID, SOLID, MOVING, SLIP, OUTLET = range(5)
"""What a cell is. Walls are cells too; a wall lies half-way between it and the fluid."""
KIND, BODY, EDGE = 7, 64, 128
"""Bits of a cell's flag: its kind; covered by a body; at the edge of its box, where cells wrap."""

SUPERSONIC = 0.16
"""Square of the speed, in lattice units, beyond which nothing here means anything (0.4)."""


@dataclass(frozen=True)
class Kernels:
    """Functions and kernels for one lattice and storage type; see ``kernels``."""

    Populations: Any
    load: Any
    neighbours: Any
    density_and_momentum: Any
    step: Any
    walls: Any
    outlet: Any
    moments: Any
    initialise: Any
    damp: Any


@wp.struct
class Box:
    """The shape of the boxes: cells along each axis, cells of one, and how many there are."""

    nx: int
    ny: int
    nz: int
    cells: int
    boxes: int


@wp.func
def place(n: int, box: Box) -> wp.vec3i:
    """Coordinates of a cell in its box."""
    rest = n % box.cells
    x = rest % box.nx
    rest = rest // box.nx
    return wp.vec3i(x, rest % box.ny, rest // box.ny)


@wp.func
def wrapped(x: int, size: int) -> int:
    """A coordinate at most one step outside, back inside."""
    if x < 0:
        return x + size
    if x >= size:
        return x - size
    return x


@cache
def kernels(lattice: Lattice, storage: str = "float32") -> Kernels:
    """Compile the kernels for a lattice; populations stored as ``float32`` or ``float16``.

    Half precision stores 2^9 (f - w): its range then ends at the deviations that a fluid at a
    tenth of the speed of sound has. Source: Lehmann et al., Phys. Rev. E 106 (2022) 015308.
    """
    c, w, pairs = lattice.velocities, lattice.weights, lattice.pairs
    kind = wp.float16 if storage == "float16" else wp.float32
    scale = 512.0 if storage == "float16" else 1.0
    Stored = wp.array2d(dtype=kind)
    Populations = wp.types.vector(length=lattice.Q, dtype=wp.float32)
    Cells = wp.types.vector(length=pairs, dtype=wp.int32)
    slip_axes = tuple(axis for axis in range(lattice.dimensions))

    @wp.func
    def read(x: kind) -> float:
        return float(x) * wp.static(1.0 / scale)

    @wp.func
    def packed(x: float) -> kind:
        return kind(x * wp.static(scale))

    @wp.func
    def neighbours(n: int, flag: int, box: Box) -> Cells:
        """Cells that the odd directions point to from cell n."""
        j = Cells()
        if (flag & wp.static(EDGE)) == 0:
            for k in range(wp.static(pairs)):
                j[k] = n + (
                    wp.static(c[2 * k + 1][0])
                    + box.nx * (wp.static(c[2 * k + 1][1]) + box.ny * wp.static(c[2 * k + 1][2]))
                )
            return j
        at = place(n, box)
        base = n - (at[0] + box.nx * (at[1] + box.ny * at[2]))
        for k in range(wp.static(pairs)):
            x = wrapped(at[0] + wp.static(c[2 * k + 1][0]), box.nx)
            y = wrapped(at[1] + wp.static(c[2 * k + 1][1]), box.ny)
            z = wrapped(at[2] + wp.static(c[2 * k + 1][2]), box.nz)
            j[k] = base + x + box.nx * (y + box.ny * z)
        return j

    @wp.func
    def load(f: Stored, n: int, j: Cells, t: int) -> Populations:
        """Populations that arrive at cell n in a step of parity t."""
        p = Populations()
        p[0] = read(f[0, n])
        for k in range(wp.static(pairs)):
            if t != 0:
                p[2 * k + 1] = read(f[2 * k + 1, n])
                p[2 * k + 2] = read(f[2 * k + 2, j[k]])
            else:
                p[2 * k + 1] = read(f[2 * k + 2, n])
                p[2 * k + 2] = read(f[2 * k + 1, j[k]])
        return p

    @wp.func
    def store(f: Stored, n: int, j: Cells, t: int, p: Populations) -> int:
        """Send populations on from cell n."""
        f[0, n] = packed(p[0])
        for k in range(wp.static(pairs)):
            if t != 0:
                f[2 * k + 2, j[k]] = packed(p[2 * k + 1])
                f[2 * k + 1, n] = packed(p[2 * k + 2])
            else:
                f[2 * k + 1, j[k]] = packed(p[2 * k + 1])
                f[2 * k + 2, n] = packed(p[2 * k + 2])
        return 0

    @wp.func
    def density_and_momentum(p: Populations) -> wp.vec4:
        """Density less 1, and momentum."""
        rho = p[0]
        mx = float(0.0)
        my = float(0.0)
        mz = float(0.0)
        for k in range(wp.static(pairs)):
            rho += p[2 * k + 1] + p[2 * k + 2]
            d = p[2 * k + 1] - p[2 * k + 2]
            mx += wp.static(float(c[2 * k + 1][0])) * d
            my += wp.static(float(c[2 * k + 1][1])) * d
            mz += wp.static(float(c[2 * k + 1][2])) * d
        return wp.vec4(rho, mx, my, mz)

    @wp.func
    def stress_norm(p: Populations, rho: float, u: wp.vec3) -> float:
        """Frobenius norm of the second moment out of equilibrium."""
        xx = float(0.0)
        yy = float(0.0)
        zz = float(0.0)
        xy = float(0.0)
        yz = float(0.0)
        zx = float(0.0)
        for k in range(wp.static(pairs)):
            s = p[2 * k + 1] + p[2 * k + 2]
            xx += wp.static(float(c[2 * k + 1][0] ** 2)) * s
            yy += wp.static(float(c[2 * k + 1][1] ** 2)) * s
            zz += wp.static(float(c[2 * k + 1][2] ** 2)) * s
            xy += wp.static(float(c[2 * k + 1][0] * c[2 * k + 1][1])) * s
            yz += wp.static(float(c[2 * k + 1][1] * c[2 * k + 1][2])) * s
            zx += wp.static(float(c[2 * k + 1][2] * c[2 * k + 1][0])) * s
        third = (rho - 1.0) / 3.0
        xx -= third + rho * u[0] * u[0]
        yy -= third + rho * u[1] * u[1]
        if wp.static(lattice.dimensions == 3):
            zz -= third + rho * u[2] * u[2]
        xy -= rho * u[0] * u[1]
        yz -= rho * u[1] * u[2]
        zx -= rho * u[2] * u[0]
        return wp.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx))

    @wp.func
    def collided(
        p: Populations, rest: float, u: wp.vec3, push: wp.vec3, tau: float, magic: float, cs2: float
    ) -> Populations:
        """Two relaxation times, a sub-grid viscosity, and a change of velocity by a body.

        Sources: Ginzburg, Adv. Water Resour. 28 (2005) 1171 (two relaxation times, ``magic``
        their product); Hou et al., Fields Inst. Comm. 6 (1996) 151 (Smagorinsky's model, ``cs2``
        the square of its constant); Kupershtokh et al., Comput. Math. Appl. 58 (2009) 965 (a force
        as the difference of two equilibria).
        """
        rho = 1.0 + rest
        tau_plus = float(tau)
        if cs2 > 0.0:
            q = wp.static(18.0 * 2.0**0.5) * cs2 * stress_norm(p, rho, u) / rho
            tau_plus = 0.5 * (tau + wp.sqrt(tau * tau + q))
        plus = 1.0 / tau_plus
        minus = 1.0 / (0.5 + magic / (tau_plus - 0.5))
        after = u + push
        square = wp.dot(u, u)
        square_after = wp.dot(after, after)
        out = Populations()
        out[0] = p[0] * (1.0 - plus) + wp.static(w[0]) * (
            plus * (rest - 1.5 * rho * square) - 1.5 * rho * (square_after - square)
        )
        for k in range(wp.static(pairs)):
            cu = (
                wp.static(float(c[2 * k + 1][0])) * u[0]
                + wp.static(float(c[2 * k + 1][1])) * u[1]
                + wp.static(float(c[2 * k + 1][2])) * u[2]
            )
            ca = (
                wp.static(float(c[2 * k + 1][0])) * after[0]
                + wp.static(float(c[2 * k + 1][1])) * after[1]
                + wp.static(float(c[2 * k + 1][2])) * after[2]
            )
            even = wp.static(w[2 * k + 1]) * (rest + rho * (4.5 * cu * cu - 1.5 * square))
            odd = wp.static(3.0 * w[2 * k + 1]) * rho * cu
            kick_even = (
                wp.static(w[2 * k + 1])
                * rho
                * (4.5 * (ca * ca - cu * cu) - 1.5 * (square_after - square))
            )
            kick_odd = wp.static(3.0 * w[2 * k + 1]) * rho * (ca - cu)
            a = p[2 * k + 1]
            b = p[2 * k + 2]
            relax_even = plus * (0.5 * (a + b) - even) - kick_even
            relax_odd = minus * (0.5 * (a - b) - odd) - kick_odd
            out[2 * k + 1] = a - relax_even - relax_odd
            out[2 * k + 2] = b - relax_even + relax_odd
        return out

    @wp.func
    def body_push(
        n: int,
        e: int,
        box: Box,
        u: wp.vec3,
        solid: wp.array(dtype=wp.float32),
        twist: wp.array2d(dtype=wp.vec4),
        centre: wp.array2d(dtype=wp.vec2),
    ) -> wp.vec3:
        """Change of velocity that the body's share of a cell asks for.

        ``solid`` holds the number of the link and its share of the cell in one number.
        """
        held = solid[n]
        link = int(held)
        share = held - float(link)
        at = place(n, box)
        x = float(at[0]) - centre[e, link][0]
        y = float(at[1]) - centre[e, link][1]
        x -= float(box.nx) * wp.floor(x / float(box.nx) + 0.5)
        y -= float(box.ny) * wp.floor(y / float(box.ny) + 0.5)
        v = twist[e, link]
        return share * wp.vec3(v[0] - v[2] * y - u[0], v[1] + v[2] * x - u[1], -u[2])

    @wp.kernel(enable_backward=False, module="unique")
    def step(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        first: int,
        t: int,
        tau: wp.array(dtype=wp.float32),
        magic: float,
        cs2: float,
        drive: wp.array(dtype=wp.vec3),
        solid: wp.array(dtype=wp.float32),
        twist: wp.array2d(dtype=wp.vec4),
        centre: wp.array2d(dtype=wp.vec2),
        stopped: wp.array(dtype=wp.int32),
    ):
        """Collide and stream cell ``first`` + thread."""
        n = first + wp.tid()
        flag = int(flags[n])
        if (flag & wp.static(KIND)) != wp.static(FLUID):
            return
        e = int(0)
        if box.boxes > 1:
            e = n // box.cells
        if stopped[e] >= 0:
            return
        j = neighbours(n, flag, box)
        p = load(f, n, j, t)
        m = density_and_momentum(p)
        rho = 1.0 + m[0]
        u = wp.vec3(m[1], m[2], m[3]) / rho
        push = drive[e]
        if (flag & wp.static(BODY)) != 0:
            push += body_push(n, e, box, u, solid, twist, centre)
        if not (wp.dot(u, u) < wp.static(SUPERSONIC)):
            stopped[e] = n - e * box.cells
        store(f, n, j, t, collided(p, m[0], u, push, tau[e], magic, cs2))

    @wp.func
    def swap(
        f: Stored, d: int, n: int, from_n: int, g: int, other: int, from_other: int, t: int
    ) -> int:
        """Exchange what arrives at cell n along d with what arrives at ``other`` along g."""
        a = d
        i = n
        if d % 2 == 0:
            i = from_n
            if t == 0:
                a = d - 1
        elif t == 0:
            a = d + 1
        b = g
        k = other
        if g % 2 == 0:
            k = from_other
            if t == 0:
                b = g - 1
        elif t == 0:
            b = g + 1
        held = f[a, i]
        f[a, i] = f[b, k]
        f[b, k] = held
        return 0

    @wp.func
    def offset(n: int, dx: int, dy: int, dz: int, box: Box) -> int:
        """The cell (dx, dy, dz) away."""
        at = place(n, box)
        x = wrapped(at[0] + dx, box.nx)
        y = wrapped(at[1] + dy, box.ny)
        z = wrapped(at[2] + dz, box.nz)
        return n + (x - at[0]) + box.nx * ((y - at[1]) + box.ny * (z - at[2]))

    # For each outward normal and each axis across it: the two directions that a mirror exchanges.
    mirrors = []
    for axis in slip_axes:
        for sign in (1, -1):
            for across in slip_axes:
                if across != axis:
                    one, two = [0, 0, 0], [0, 0, 0]
                    one[axis] = two[axis] = sign
                    one[across], two[across] = 1, -1
                    along = tuple(int(k == across) for k in range(3))
                    mirrors.append(
                        (
                            2 * axis + (sign < 0),
                            lattice.index(tuple(one)),
                            lattice.index(tuple(two)),
                            along,
                            tuple(one),
                            tuple(two),
                        )
                    )

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
        """What walls do to the populations that arrive in them, before these turn back.

        A moving wall adds its momentum (Ladd, J. Fluid Mech. 271 (1994) 285); a free-slip wall
        exchanges its cells' populations along the wall, so that they leave as from a mirror; an
        outlet at density 1 turns them round by anti-bounce-back (Ginzburg et al., Commun. Comput.
        Phys. 3 (2008) 427).
        """
        e, k = wp.tid()
        n = e * box.cells + listed[k]
        flag = int(flags[n])
        what = flag & wp.static(KIND)
        if what == wp.static(SLIP):
            for m in range(wp.static(len(mirrors))):
                if normal[k] == wp.static(mirrors[m][0]):
                    other = offset(
                        n,
                        wp.static(mirrors[m][3][0]),
                        wp.static(mirrors[m][3][1]),
                        wp.static(mirrors[m][3][2]),
                        box,
                    )
                    if (int(flags[other]) & wp.static(KIND)) == wp.static(SLIP):
                        swap(
                            f,
                            wp.static(mirrors[m][2]),
                            n,
                            offset(
                                n,
                                wp.static(-mirrors[m][5][0]),
                                wp.static(-mirrors[m][5][1]),
                                wp.static(-mirrors[m][5][2]),
                                box,
                            ),
                            wp.static(mirrors[m][1]),
                            other,
                            offset(
                                other,
                                wp.static(-mirrors[m][4][0]),
                                wp.static(-mirrors[m][4][1]),
                                wp.static(-mirrors[m][4][2]),
                                box,
                            ),
                            t,
                        )
            return
        u = velocity[k]
        j = neighbours(n, flag, box)
        p = load(f, n, j, t)
        out = Populations()
        out[0] = p[0]
        for d in range(wp.static(pairs)):
            cu = (
                wp.static(float(c[2 * d + 1][0])) * u[0]
                + wp.static(float(c[2 * d + 1][1])) * u[1]
                + wp.static(float(c[2 * d + 1][2])) * u[2]
            )
            a = p[2 * d + 1]
            b = p[2 * d + 2]
            if what == wp.static(MOVING):
                kick = wp.static(6.0 * w[2 * d + 1]) * cu
                out[2 * d + 1] = b + kick
                out[2 * d + 2] = a - kick
            else:
                even = wp.static(2.0 * w[2 * d + 1]) * (4.5 * cu * cu - 1.5 * wp.dot(u, u))
                out[2 * d + 1] = even - b
                out[2 * d + 2] = even - a
        store(f, n, j, t, out)

    @wp.kernel(enable_backward=False, module="unique")
    def outlet(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        listed: wp.array(dtype=wp.int32),
        inside: wp.array(dtype=wp.int32),
        velocity: wp.array(dtype=wp.vec3),
    ):
        """Give outlet cells the velocity of the fluid cell before them; first box only."""
        k = wp.tid()
        n = inside[k]
        if n < 0:
            return
        flag = int(flags[n])
        m = density_and_momentum(load(f, n, neighbours(n, flag, box), t))
        velocity[k] = wp.vec3(m[1], m[2], m[3]) / (1.0 + m[0])

    @wp.kernel(enable_backward=False, module="unique")
    def moments(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        density: wp.array(dtype=wp.float32),
        velocity: wp.array(dtype=wp.vec3),
    ):
        """Density less 1 and velocity of every fluid cell; 0 in walls."""
        n = wp.tid()
        flag = int(flags[n])
        if (flag & wp.static(KIND)) != wp.static(FLUID):
            density[n] = 0.0
            velocity[n] = wp.vec3()
            return
        m = density_and_momentum(load(f, n, neighbours(n, flag, box), t))
        density[n] = m[0]
        velocity[n] = wp.vec3(m[1], m[2], m[3]) / (1.0 + m[0])

    @wp.kernel(enable_backward=False, module="unique")
    def initialise(
        f: Stored,
        flags: wp.array(dtype=wp.uint8),
        box: Box,
        t: int,
        tau: wp.array(dtype=wp.float32),
        density: wp.array(dtype=wp.float32),
        velocity: wp.array(dtype=wp.vec3),
        stress: wp.array2d(dtype=wp.float32),
    ):
        """Set what will arrive at each cell: equilibrium plus the part that the shear rate brings.

        ``stress`` holds the rates of strain xx, yy, zz, xy, yz, zx, or nothing. Source: Kruger et
        al. (2017), eq. 5.41.
        """
        n = wp.tid()
        flag = int(flags[n])
        u = velocity[n]
        rho = 1.0 + density[n]
        p = Populations()
        uu = wp.dot(u, u)
        p[0] = wp.static(w[0]) * (density[n] - 1.5 * rho * uu)
        e = n // box.cells
        for k in range(wp.static(pairs)):
            cu = (
                wp.static(float(c[2 * k + 1][0])) * u[0]
                + wp.static(float(c[2 * k + 1][1])) * u[1]
                + wp.static(float(c[2 * k + 1][2])) * u[2]
            )
            even = wp.static(w[2 * k + 1]) * (density[n] + rho * (4.5 * cu * cu - 1.5 * uu))
            if stress.shape[0] > 0:
                s = (
                    wp.static(float(c[2 * k + 1][0] ** 2)) * stress[n, 0]
                    + wp.static(float(c[2 * k + 1][1] ** 2)) * stress[n, 1]
                    + wp.static(float(c[2 * k + 1][2] ** 2)) * stress[n, 2]
                    + wp.static(2.0 * float(c[2 * k + 1][0] * c[2 * k + 1][1])) * stress[n, 3]
                    + wp.static(2.0 * float(c[2 * k + 1][1] * c[2 * k + 1][2])) * stress[n, 4]
                    + wp.static(2.0 * float(c[2 * k + 1][2] * c[2 * k + 1][0])) * stress[n, 5]
                )
                even -= wp.static(3.0 * w[2 * k + 1]) * tau[e] * rho * s
            odd = wp.static(3.0 * w[2 * k + 1]) * rho * cu
            p[2 * k + 1] = even - odd
            p[2 * k + 2] = even + odd
        # Stored as if sent in the step before, which had the other parity and the slots of this
        # one: what arrives along a direction lies where its opposite will be sent from.
        store(f, n, neighbours(n, flag, box), t, p)

    @wp.kernel(enable_backward=False, module="unique")
    def damp(
        f: Stored,
        box: Box,
        position: wp.array(dtype=wp.vec2),
        reach: wp.vec2,
        width: float,
        strength: float,
    ):
        """Bring cells far from each box's robot nearer to rest: a sponge that goes with it.

        The populations of water at rest are 0 as stored, so a factor on each slot is enough. The
        factor falls as the square of the depth into the sponge, which reflects little sound.
        """
        e, n = wp.tid()
        at = place(n, box)
        dx = float(at[0]) - position[e][0]
        dy = float(at[1]) - position[e][1]
        dx = wp.abs(dx - float(box.nx) * wp.floor(dx / float(box.nx) + 0.5)) - reach[0]
        dy = wp.abs(dy - float(box.ny) * wp.floor(dy / float(box.ny) + 0.5)) - reach[1]
        depth = wp.max(dx, dy) / width
        if depth <= 0.0:
            return
        keep = 1.0 - strength * wp.min(depth * depth, 1.0)
        cell = e * box.cells + n
        for d in range(wp.static(lattice.Q)):
            f[d, cell] = packed(keep * read(f[d, cell]))

    return Kernels(
        Populations, load, neighbours, density_and_momentum, step, walls, outlet, moments,
        initialise, damp,
    )  # fmt: skip
