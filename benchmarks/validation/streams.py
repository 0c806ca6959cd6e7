"""Streams along walls and past cylinders that are held."""

from __future__ import annotations

import numpy as np

from benchmarks.validation.case import (
    CPU,
    Case,
    Figure,
    Where,
    ball,
    forces,
    prescribed,
)
from sim.lattice.cell import MOVING, SOLID
from sim.lattice.velocities import D2Q9
from sim2real.arrays import Array

_LID = 0.1
"""Speed of the cavity's lid in cells a step."""
_STEADY, _LONGEST = 2e-5, 120
"""Change, in lid speeds while the lid moves its length, below which the flow is steady."""
GHIA = {
    100.0: (-0.21090, 0.17527, -0.24533),
    400.0: (-0.32726, 0.30203, -0.44993),
    1000.0: (-0.38289, 0.37095, -0.51550),
}
"""Least velocity along the lid on the vertical centre line, largest and least velocity upwards on
the horizontal one, in lid speeds, by the Reynolds number: tables I and II."""


def slide(reynolds: float, cells: int, where: Where) -> tuple[Array, Array]:
    """Steady velocities on the centre lines, along the lid and upwards, in lid speeds.

    ``cells`` a side is odd, so that one is in the middle.
    """
    walls = np.zeros((cells + 1, cells + 2), np.uint8)
    walls[0] = walls[:, 0] = SOLID  # cells wrap: the first column is the wall on either side
    walls[1:, -1] = MOVING
    velocity = np.zeros((*walls.shape, 3), np.float32)
    velocity[1:, -1, 0] = _LID
    walls[0, -1] = SOLID
    more = {"walls": walls, "wall_velocity": velocity}
    fluid = where.fluid(D2Q9, walls.shape, viscosity=_LID * cells / reynolds, **more)
    u = np.zeros((cells, cells, 3), np.float32)
    for _ in range(_LONGEST):
        before = u
        fluid.step(round(cells / _LID))
        u = fluid.moments()[1][0, 1:, 1:-1, 0] / _LID
        if float(np.abs(u - before).max()) < _STEADY:
            break
    return u[cells // 2, :, 0].astype(float), u[:, cells // 2, 1].astype(float)


def cavity(where: Where = CPU) -> Case:
    """A lid-driven square; if quick only the smallest Reynolds number, in coarser cells."""
    cells = {100.0: 33} if where.quick else {100.0: 65, 400.0: 97, 1000.0: 97}
    figures = []
    for reynolds, n in cells.items():
        u, v = slide(reynolds, n, where)
        found = {"least u": u.min(), "largest v": v.max(), "least v": v.min()}
        figures += [
            Figure(f"{name} at Re {reynolds:g}, in lid speeds", float(ours), known, 0.01, 1.0)
            for (name, ours), known in zip(found.items(), GHIA[reynolds], strict=True)
        ]
    return Case(
        "Lid-driven cavity",
        "Ghia, Ghia and Shin, J. Comput. Phys. 48 (1982) 387",
        f"{', '.join(f'{n}' for n in cells.values())} cells a side, lid at {_LID:g} cells a step, "
        f"until steady within {_STEADY:g} a turnover",
        figures,
    )


REYNOLDS = 100.0
"""Of the cylinder without a channel."""
_TOW = 0.06
"""Speed in cells a step."""
_BOX = (16, 10)
"""Sides in diameters."""


def towed_and_held(diameter: int, time: float, where: Where) -> tuple[Array, Array]:
    """Times in diameters over the speed, and drag coefficients, towed and held: shape (T, 2).

    Two periodic boxes, one at rest, one a stream, both started impulsively.
    """
    size = (_BOX[0] * diameter, _BOX[1] * diameter)
    fluid = where.fluid(D2Q9, size, viscosity=_TOW * diameter / REYNOLDS, boxes=2)
    velocity = np.zeros((2, 1, 1, 1, 3))
    velocity[1, ..., 0] = _TOW
    fluid.set(velocity=velocity)
    start = np.array([[size[0] / 2 + 0.2, size[1] / 2 + 0.1, 0.0]])
    bodies = prescribed(fluid, ball(diameter / 2), start)
    every = round(0.1 * diameter / _TOW)
    looks = round(time * diameter / _TOW / every)
    rate = np.array([[-_TOW, 0.0, 0.0], [0.0, 0.0, 0.0]])
    force = forces(bodies, [rate] * (every * looks))[..., 0].reshape(looks, every, 2).mean(axis=1)
    times = (np.arange(looks) + 0.5) * every * _TOW / diameter
    return times, force / (0.5 * _TOW**2 * diameter)


def moving_cylinder(where: Where = CPU) -> Case:
    """Towed against held, which fails with simple momentum exchange."""
    diameter = 12 if where.quick else 20
    times, drag = towed_and_held(diameter, 5.0 if where.quick else 12.0, where)
    towed, held = drag[times > 2.0].mean(axis=0)
    return Case(
        "Cylinder at Re 100, towed and held",
        "Galilei's principle",
        f"{diameter} cells a diameter, periodic, {_BOX[0]} x {_BOX[1]} diameters, set going at "
        f"once at {_TOW:g} cells a step",
        [Figure("mean drag coefficient towed, against held", float(towed), float(held), 0.02)],
    )
