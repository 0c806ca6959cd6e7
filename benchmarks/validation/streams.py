"""Streams along walls and past cylinders that are held."""

from __future__ import annotations

import numpy as np

from benchmarks.validation.case import (
    CPU,
    Case,
    Figure,
    Ramp,
    Where,
    ball,
    forces,
    frequency,
    prescribed,
)
from sim.fluid.fluid import CS2
from sim.lattice.cell import INLET, MOVING, OUTLET, SOLID
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import HELD, inset_at
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


LENGTH, HEIGHT, CENTRE = 22.0, 4.1, (2.0, 2.0)
"""Of the channel, in diameters of its cylinder; speeds are in mean speeds of the stream."""
DRAG, LIFT, PRESSURE = 5.57953523384, 0.010618948146, 0.11752016697
"""Case 2D-1; the pressure between the cylinder's front and back is in the benchmark's own Pa."""
LEAST_DRAG, MOST_DRAG, LIFT_SWING, STROUHAL = 3.164263, 3.227393, 2.007871, 0.301841
"""Case 2D-2."""
_PASCAL = 0.2**2
"""Density times the square of the mean speed in case 2D-1, in the benchmark's units."""
_PEAK = 0.075
"""Largest speed of the inflow in cells a step."""
_MEAN = 2 / 3 * _PEAK
_RAISED, _LOOKS = 8.0, 100


def hold(reynolds: float, diameter: int, time: float, where: Where) -> tuple[Array, Array, float]:
    """Times in diameters over the mean speed, coefficients of drag and lift (T, 2), and pressure.

    The pressure is the difference of front and back at the end, over density and mean speed
    squared. The row y = 0 is the wall on either side.
    """
    size = (round(LENGTH * diameter) + 2, round(HEIGHT * diameter) + 1)
    walls, normals = np.zeros(size, np.uint8), np.zeros(size, np.int32)
    walls[0], normals[0] = INLET, 1
    walls[-1], normals[-1] = OUTLET, 0
    walls[:, 0] = SOLID
    across = (np.arange(size[1]) - 0.5) / (size[1] - 1)
    velocity = np.zeros((*size, 3), np.float32)
    velocity[0, 1:, 0] = (4 * _PEAK * across * (1 - across))[1:]
    viscosity = _MEAN * diameter / reynolds
    more = {"walls": walls, "normals": normals, "wall_velocity": velocity}
    fluid = where.fluid(D2Q9, size, viscosity=viscosity, **more)
    x, y = (c * diameter + 0.5 for c in CENTRE)
    start, inset = np.array([[x, y, 0.0]]), inset_at(viscosity)
    cylinder = prescribed(fluid, ball(diameter / 2), start, inset=inset)
    ramp = Ramp(fluid, round(_RAISED * diameter / _MEAN))
    every = max(1, round(diameter / _MEAN / _LOOKS))
    looks = round(time * diameter / _MEAN / every)
    force = np.zeros((looks, 2))
    for k in range(looks):
        ramp.at(k * every)
        for _ in range(every):
            cylinder.step(HELD)
        force[k] = cylinder.motion.force.numpy()[0, 0, :2]
    density = fluid.moments()[0][0, :, :, 0].astype(np.float64)
    row = density[:, [int(y), int(y) + 1]].mean(axis=1)
    front, back = np.interp([x - diameter / 2, x + diameter / 2], np.arange(row.size), row)
    times = (np.arange(looks) + 1) * every * _MEAN / diameter
    return times, force / (0.5 * _MEAN**2 * diameter), float((front - back) * CS2 / _MEAN**2)


def channel_cylinder(where: Where = CPU) -> Case:
    """The DFG benchmark's case 2D-1, and, if not quick, also 2D-2."""
    diameter = 10 if where.quick else (60 if where.gpu else 30)
    t, force, pressure = hold(20.0, diameter, 14.0 if where.quick else 20.0, where)
    drag, lift = force[t > t[-1] - 1].mean(axis=0)
    figures = [
        Figure("2D-1 drag coefficient", float(drag), DRAG, 0.06 if where.quick else 0.015),
        Figure("2D-1 lift coefficient", float(lift), LIFT),
        Figure("2D-1 pressure difference in Pa", pressure * _PASCAL, PRESSURE),
    ]
    if not where.quick:
        t, force, _ = hold(100.0, diameter, 60.0, where)
        late = t > t[-1] - 10
        drag, lift = force[late].T
        figures += [
            Figure("2D-2 least drag coefficient", float(drag.min()), LEAST_DRAG, 0.015),
            Figure("2D-2 largest drag coefficient", float(drag.max()), MOST_DRAG, 0.015),
            Figure("2D-2 lift coefficient, peak to peak", float(np.ptp(lift)), LIFT_SWING, 0.04),
            Figure("2D-2 Strouhal number", frequency(t[late], lift), STROUHAL, 0.01),
        ]
    return Case(
        "Cylinder in a channel, DFG benchmark 2D-1 (Re 20) and 2D-2 (Re 100)",
        "Schaefer and Turek, Notes Numer. Fluid Mech. 52 (1996) 547; precise figures are those of "
        "the FeatFlow project's benchmark pages",
        f"{diameter} cells a diameter, largest inflow {_PEAK:g} cells a step, raised over "
        f"{_RAISED:g} diameters; the cylinder as solid shares of cells",
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
