"""Bodies along which water slips, with and without friction: spheroids and plates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.validation.case import (
    CPU,
    LATTICE,
    Case,
    Figure,
    Where,
    amplitude,
    forces,
    prescribed,
)
from sim.fluid.wall import Wall
from sim.lattice.velocities import D3Q19, WATER_KG_M3, WATER_M2_S, Units
from sim.robot.bodies import KINEMATIC, Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim2real.arrays import Array

SMOOTH = Wall(slip=True)
"""Slip without friction."""
FINENESS = 6.0
LENGTH_M, SPEED_M_S = 0.4, 0.5
REYNOLDS = LENGTH_M * SPEED_M_S / WATER_M2_S
_LINKS = 6
_VISCOSITY, _SMAGORINSKY = 1e-3, 0.1
"""Of the lattice: the smallest that is stable. The friction line uses that of water."""
_PERIOD, _PERIODS = 800, 2
_SWAY = 0.2
"""Amplitude of the oscillation in cells."""
_SHAKEN, _TOWED, _TOWED_ASKEW = (2.0, 1.25, 1.25), (2.5, 1.25, 1.25), (2.5, 1.75, 1.25)
"""Periodic boxes in lengths."""
SPEED = 0.05
"""Towing speed in cells per step."""
_LENGTHS = 1.0
"""Towed lengths, before it meets its wake in the periodic box; the second half is evaluated."""
FRAMES = {
    "towed": (1.0, 0.0),
    "at rest in a stream": (0.0, 0.0),
    "towed at 20 degrees": (1.0, 20.0),
}
"""Share of the speed that the body moves at and its angle to the cells, see ``drag``."""
DRAG_BARS = {4: 0.01, 8: 0.004, 16: 0.004}
"""Of the drag coefficient without friction, by the cells of thickness."""
_ALIKE = 0.005


def carried(fineness: float = FINENESS) -> tuple[float, float]:
    """Added mass end-on and broadside over the displaced mass: Lamb's k1 and k2.

    With the eccentricity e, alpha = 2 (1 - e^2) / e^3 (artanh e - e) and beta = 1 - alpha / 2:
    k1 = alpha / (2 - alpha), k2 = beta / (2 - beta).
    """
    e = np.sqrt(1 - 1 / fineness**2)
    alpha = 2 * (1 - e**2) / e**3 * (np.arctanh(e) - e)
    beta = 1 - alpha / 2
    return float(alpha / (2 - alpha)), float(beta / (2 - beta))


def wetted(length: float) -> float:
    """Area of the spheroid's surface."""
    e, thick = np.sqrt(1 - 1 / FINENESS**2), length / FINENESS
    return float(np.pi / 2 * thick * (thick + length * np.arcsin(e) / e))


def plate_friction(reynolds: float = REYNOLDS) -> float:
    """Friction coefficient of a smooth plate: the line of 1957."""
    return float(0.075 / (np.log10(reynolds) - 2) ** 2)


def slipping(fineness: float = FINENESS) -> float:
    """Friction end-on over the plate's, for a stress of Cf / 2 u^2 with the ideal fluid's u.

    The ideal fluid slips along the surface at 1 + k1 times the tow's component t along it, and t of
    the stress is along the axis: (1 + k1)^2 times the mean of t^3 over the surface.
    """
    angle = (np.arange(20000) + 0.5) * np.pi / 20000  # x is its cosine, r its sine over fineness
    dx, dr = np.sin(angle), np.cos(angle) / fineness
    ds = np.hypot(dx, dr)
    area = np.sin(angle) * ds
    return float((1 + carried(fineness)[0]) ** 2 * np.sum((dx / ds) ** 3 * area) / np.sum(area))


def prolate(length: float) -> Hull:
    """The spheroid as a chain with its radius at the links' ends and middles.

    The round ends touch the poles and join the spheroid where the radii are equal.
    """
    end = (1 - 1 / FINENESS**2) / (1 + 1 / FINENESS**2)
    x = end * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * _LINKS + 1))  # closer at the ends
    x[1::2] = (x[:-1:2] + x[2::2]) / 2
    radius = length / 2 / FINENESS * np.sqrt(1 - x**2)
    half = np.stack([radius[:-1:2], radius[1::2], radius[2::2]], axis=1)
    return Hull(length / 2 * np.diff(x[::2]), half, half)


def masses(length: int, where: Where = CPU) -> Array:
    """Mass of body and added mass over the displaced mass, end-on and broadside.

    An oscillating force drives the free, neutrally buoyant body, in one box for each direction.
    Units are those of the lattice.
    """
    cells = tuple(round(side * length) for side in _SHAKEN)
    fluid = where.fluid(D3Q19, cells, viscosity=_VISCOSITY, boxes=2)
    hull = prolate(float(length))
    links, volume = hull.length.size, np.pi / 6 * length**3 / FINENESS**2
    true = displaced(hull, 0.5, 0.0, False)
    true[:, [0, 2]] *= volume / true[:, 0].sum()
    weights = Masses(true[:, 0], true[:, 2], true[:, 1])
    bodies = Bodies(fluid, hull, weights, LATTICE, wall=SMOOTH)
    start = np.zeros((2, 2 + links))
    start[:, 0] = (cells[0] + length) / 2 + 0.3
    start[:, 1] = cells[1] / 2 + 0.2
    bodies.place(start)
    omega = 2 * np.pi / _PERIOD
    force = volume * _SWAY * omega**2
    push = np.zeros_like(start)
    speed = np.zeros((_PERIODS * _PERIOD, 2))
    arm = hull.length.sum() / 2 - true[0, 1]  # from the head's centre of mass to the middle
    for n in range(len(speed)):
        now = force * np.cos(omega * (n + 0.5))
        push[0, 0], push[1, 1], push[1, 2] = now, now, -now * arm
        bodies.push(push)
        bodies.step(KINEMATIC)
        v = bodies.motion.v.numpy()
        speed[n] = v[0, 0], v[1, 1] - arm * v[1, 2]
    if fluid.stopped.numpy().max() >= 0:  # the flow broke down
        return np.full(2, np.nan)
    return np.asarray(force / (omega * volume * amplitude(speed[-_PERIOD:], _PERIOD)))


def drag(
    length: int,
    wall: Wall,
    *,
    body: float = 1.0,
    degrees: float = 0.0,
    speed: float = SPEED,
    where: Where = CPU,
) -> tuple[Array, Array]:
    """Lengths moved through the water end-on, and the drag coefficient on the wetted area.

    Args:
        length: Cells along the body.
        wall: The wall model.
        body: Frame of reference: the body moves at this share of the speed through the water, the
            water far away at this share less 1. It is towed at 1, and in a stream at rest at 0.
        degrees: Angle of the body and its motion to the cells.
        speed: Speed through the water in cells per step; a lower one is a shorter time step at the
            same Reynolds number.
        where: Device of the fluid.
    """
    sides = _TOWED if degrees == 0 else _TOWED_ASKEW
    cells = tuple(round(side * length) for side in sides)
    fluid = where.fluid(
        D3Q19, cells, viscosity=_VISCOSITY * speed / SPEED, smagorinsky=_SMAGORINSKY
    )
    angle = np.deg2rad(degrees)
    ahead = np.array([np.cos(angle), np.sin(angle)])
    if body != 1.0:
        fluid.set(velocity=np.array([*((body - 1.0) * speed * ahead), 0.0]))
    hull, cell = prolate(LENGTH_M), LENGTH_M / length
    units = Units(cell, speed * cell / SPEED_M_S, cell)
    place = np.array([cells[0] / 2, cells[1] / 2 + 0.2])
    if degrees:  # the middle of the path in that of the box
        place += ahead * length * (0.5 - 0.5 * body * _LENGTHS)
    start = np.zeros((1, 2 + hull.length.size))
    start[0, :3] = *(cell * place), angle
    middle = (cells[2] - 1) / 2 + 0.1
    bodies = prescribed(fluid, hull, start, units, middle=middle, wall=wall)
    steps, ramp = round(_LENGTHS * length / speed), 0.1 * length / speed
    share = 0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, (np.arange(steps) + 1) / ramp))
    rates = np.zeros((steps, start.size))
    rates[:, :2] = body * SPEED_M_S * share[:, None] * ahead
    force = -(forces(bodies, rates)[:, 0, :2] @ ahead)
    unit = 0.5 * WATER_KG_M3 * SPEED_M_S**2 * wetted(LENGTH_M)
    return np.cumsum(share) * speed / length, force / unit


def steady(moved: Array, found: Array) -> float:
    """Mean over the second half of the way."""
    return float(found[moved > moved[-1] / 2].mean())


def friction(length: int, wall: Wall, where: Where = CPU) -> float:
    """Friction of a wall's line over the expected one, from the drag of tows with and without it.

    ``wall`` has a friction line. Expected is ``slipping() * plate_friction()`` on the wetted area.
    """
    tows = [drag(length, one, where=where) for one in (wall, replace(wall, line="none"))]
    rough, bare = (steady(*tow) for tow in tows)
    return (rough - bare) / (slipping() * plate_friction())


def frames(length: int, where: Where = CPU) -> list[Figure]:
    """Drag coefficient without friction in each frame, and the largest difference between them."""
    thick = round(length / FINENESS)
    bar = DRAG_BARS.get(thick)
    found = {
        frame: steady(*drag(length, SMOOTH, body=body, degrees=degrees, where=where))
        for frame, (body, degrees) in FRAMES.items()
    }
    label = f"{thick} cells thick"
    figures = [
        Figure(f"drag coefficient without friction, {frame}, {label}", value, 0.0, bar, 1.0)
        for frame, value in found.items()
    ]
    apart = float(np.ptp(list(found.values())))
    quantity = f"largest difference between the frames, {label}"
    return [*figures, Figure(quantity, apart, 0.0, None if bar is None else _ALIKE, 1.0)]


def spheroid(where: Where = CPU) -> Case:
    """48 cells long and 8 thick (24 and 4 if quick, 96 and 16 on a GPU).

    Without friction there is no drag in steady motion in any frame of reference (d'Alembert); that
    is compared at 4 cells of thickness (2 if quick, also 8 and 16 on a GPU). Of the rest only the
    mass end-on is judged: the other two are off by more than a bar would allow.
    """
    length = 24 if where.quick else (96 if where.gpu else 48)
    compared = (12,) if where.quick else ((24, 48, 96) if where.gpu else (24,))
    k1, k2 = carried()
    along, across = masses(length, where)
    rough = friction(length, Wall(True, "turbulent"), where) * slipping() * plate_friction()
    return Case(
        "Prolate spheroid along which water slips",
        "Lamb, The inertia-coefficients of an ellipsoid moving in fluid, ARC R&M 623 (1918), and "
        "Hydrodynamics (1932), art. 105, 114; friction line: International Towing Tank "
        "Conference, 1957",
        f"D3Q19, {length} cells long, {length / FINENESS:.0f} thick, periodic; shaken by "
        f"{_SWAY:g} cells, {_PERIOD} steps a period; towed {_LENGTHS:g} length at Re "
        f"{REYNOLDS:g}, {SPEED:g} cells a step",
        [
            Figure("mass end-on over the displaced water's", float(along), 1 + k1, 0.1),
            Figure("mass broadside over the displaced water's", float(across), 1 + k2),
            Figure("friction end-on on the wetted area", rough, slipping() * plate_friction()),
            *(figure for cells in compared for figure in frames(cells, where)),
        ],
    )


SQUARE = 1.17
"""Drag coefficient of a plate on its area, at Reynolds numbers of 1e4 and more."""


def plate_drag(side: int, lengths: float = 10.0, where: Where = CPU) -> tuple[Array, Array]:
    """Sides moved and drag coefficient of a square plate one cell thick, at each step.

    Its speed grows over the first of the ``lengths`` of its side, ``side`` cells, that it is towed.
    """
    cells = (round((lengths + 6) * side), 6 * side, 6 * side)
    fluid = where.fluid(D3Q19, cells, viscosity=3e-4, smagorinsky=0.17)
    hull = Hull(np.array([side - 1.0]), np.full((1, 3), 0.5), np.full((1, 3), side / 2))
    start = np.array([[3.0 * side + 0.2, cells[1] / 2 + side / 2, np.pi / 2]])
    middle = (cells[-1] - 1) / 2 + 0.1
    bodies = prescribed(fluid, hull, start, middle=middle, wall=SMOOTH)
    steps = round(lengths * side / SPEED)
    share = np.minimum(1.0, np.arange(steps) * SPEED / side)
    force = -forces(bodies, SPEED * share[:, None] * [1.0, 0.0, 0.0])[:, 0, 0]
    return np.cumsum(share) * SPEED / side, force / (0.5 * SPEED**2 * side**2)


def plate(where: Where = CPU) -> Case:
    """5 cells a side on a CPU, 12 and 24 on a GPU, where they have a bar.

    It is judged in each third of the second half of its way; if quick that is too short for the
    figures to mean anything. Hoerner's cylinders with their axis along the stream are no case:
    thick links have round ends, only parts thinner than the grid resolves end sharply.
    """
    sides = (12, 24) if where.gpu else (5,)
    sides, lengths = ((4,), 3.0) if where.quick else (sides, 10.0)
    figures = []
    for side in sides:
        moved, found = plate_drag(side, lengths, where)
        second = [np.array_split(values[found.size // 2 :], 3) for values in (moved, found)]
        for way, values in zip(*second, strict=True):
            quantity = f"drag coefficient after {way[0]:.1f} sides, {side} cells"
            bar = 0.1 if where.gpu else None
            figures.append(Figure(quantity, float(values.mean()), SQUARE, bar))
    return Case(
        "A sharp-edged square plate across the stream",
        "Hoerner, Fluid-Dynamic Drag (1965), chapter 3",
        f"one cell thick, towed {lengths:g} sides at {SPEED:g} cells a step, box 6 sides wide and "
        "high; second half of the way",
        figures,
    )
