"""Collision of the populations in a cell, and the effect of a body force on them.

Two relaxation times: Ginzburg, Adv. Water Resour. 28 (2005) 1171. Sub-grid viscosity: Hou et al.,
Fields Inst. Comm. 6 (1996) 151. A force adds the difference of two equilibria: Kupershtokh et al.,
Comput. Math. Appl. 58 (2009) 965. Symbols: rest density minus 1, m momentum, inv one over the
density, plus and minus the relaxation rates of the even and the odd part.
"""

from functools import cache
from typing import Any

import warp as wp

from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice


@cache
def collision(lattice: Lattice, wide: bool) -> tuple[Any, Any, Any]:
    """Relaxation rates with sub-grid viscosity; populations after a collision; after a push."""
    c, w, pairs = lattice.velocities, lattice.weights, lattice.pairs
    solid = lattice.dimensions == 3
    Vector = populations(lattice, wide).Vector

    @wp.func
    def along(m: wp.vec3, x: float, y: float, z: float) -> float:
        return x * m[0] + y * m[1] + z * m[2]

    @wp.func
    def subgrid_tau(
        p: Vector, rest: float, m: wp.vec3, inv: float, tau: float, square: float
    ) -> float:
        """``square`` is that of Smagorinsky's constant."""
        xx = -rest / 3.0 - m[0] * m[0] * inv
        yy = -rest / 3.0 - m[1] * m[1] * inv
        zz = float(0.0)
        if wp.static(solid):
            zz = -rest / 3.0 - m[2] * m[2] * inv
        xy = -m[0] * m[1] * inv
        yz = -m[1] * m[2] * inv
        zx = -m[2] * m[0] * inv
        for k in range(wp.static(pairs)):
            s = p[2 * k + 1] + p[2 * k + 2]
            if wp.static(c[2 * k + 1][0] != 0):
                xx += s
            if wp.static(c[2 * k + 1][1] != 0):
                yy += s
            if wp.static(c[2 * k + 1][2] != 0):
                zz += s
            if wp.static(c[2 * k + 1][0] * c[2 * k + 1][1] != 0):
                xy += wp.static(float(c[2 * k + 1][0] * c[2 * k + 1][1])) * s
            if wp.static(c[2 * k + 1][1] * c[2 * k + 1][2] != 0):
                yz += wp.static(float(c[2 * k + 1][1] * c[2 * k + 1][2])) * s
            if wp.static(c[2 * k + 1][2] * c[2 * k + 1][0] != 0):
                zx += wp.static(float(c[2 * k + 1][2] * c[2 * k + 1][0])) * s
        norm = wp.sqrt(xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + yz * yz + zx * zx))
        return 0.5 * (tau + wp.sqrt(tau * tau + wp.static(18.0 * 2.0**0.5) * square * norm * inv))

    @wp.func
    def rates(
        p: Vector,
        rest: float,
        m: wp.vec3,
        inv: float,
        tau: float,
        magic: float,
        square: float,
        more: float,
    ) -> wp.vec2:
        """Rates of the even and the odd part; ``more`` is added to the relaxation time."""
        above = subgrid_tau(p, rest, m, inv, tau, square) - 0.5 + more
        return wp.vec2(1.0 / (above + 0.5), above / (0.5 * above + magic))

    @wp.func
    def relaxed(
        p: Vector, rest: float, m: wp.vec3, inv: float, plus: float, minus: float
    ) -> Vector:
        out = Vector()
        still = rest - 1.5 * inv * wp.dot(m, m)
        curve = 4.5 * inv
        half_plus = 0.5 * plus
        half_minus = 0.5 * minus
        out[0] = p[0] + plus * (wp.static(w[0]) * still - p[0])
        for k in range(wp.static(pairs)):
            cm = along(
                m,
                wp.static(float(c[2 * k + 1][0])),
                wp.static(float(c[2 * k + 1][1])),
                wp.static(float(c[2 * k + 1][2])),
            )
            a = p[2 * k + 1]
            b = p[2 * k + 2]
            even = wp.static(w[2 * k + 1]) * plus * (still + curve * (cm * cm))
            even -= half_plus * (a + b)
            odd = wp.static(3.0 * w[2 * k + 1]) * minus * cm - half_minus * (a - b)
            out[2 * k + 1] = a + (even + odd)
            out[2 * k + 2] = b + (even - odd)
        return out

    @wp.func
    def pushed(p: Vector, rho: float, u: wp.vec3, push: wp.vec3) -> Vector:
        out = p
        after = u + push
        still = 1.5 * rho * (wp.dot(u, u) - wp.dot(after, after))
        out[0] += wp.static(w[0]) * still
        for k in range(wp.static(pairs)):
            x = wp.static(float(c[2 * k + 1][0]))
            y = wp.static(float(c[2 * k + 1][1]))
            z = wp.static(float(c[2 * k + 1][2]))
            cu = along(u, x, y, z)
            cp = along(push, x, y, z)
            even = wp.static(w[2 * k + 1]) * (still + 4.5 * rho * cp * (2.0 * cu + cp))
            odd = wp.static(3.0 * w[2 * k + 1]) * rho * cp
            out[2 * k + 1] += even + odd
            out[2 * k + 2] += even - odd
        return out

    return rates, relaxed, pushed
