"""A prolate spheroid with slip along its surface: its added mass and its friction.

Sources: Lamb, The inertia-coefficients of an ellipsoid moving in fluid, ARC R&M 623 (1918), and
Hydrodynamics (1932), art. 105 and 114: ideal fluid, which slips. For a length of six thicknesses
the added mass is 0.045 end-on and 0.918 broadside of the displaced water. The friction line:
International Towing Tank Conference, 1957. Without friction there is no drag in steady motion
(d'Alembert), in any frame of reference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.cases.walls import WALLS
from sim.fluid.fluid import Fluid
from sim.fluid.wall import Wall
from sim.lattice.units import WATER_KG_M3, WATER_M2_S, Units
from sim.lattice.velocities import D3Q19
from sim.robot.bodies import HELD, KINEMATIC, Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim2real.arrays import Array

FINENESS = 6.0
CARRIED = (0.045, 0.918)
"""Lamb's table for a fineness of 6.01, end-on and broadside, for the tests."""
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


def wetted(length: float, fineness: float = FINENESS) -> float:
    """Area of the spheroid's surface."""
    e = np.sqrt(1 - 1 / fineness**2)
    thick = length / fineness
    return float(np.pi / 2 * thick * (thick + length * np.arcsin(e) / e))


def plate(reynolds: float = REYNOLDS) -> float:
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


def prolate(length: float, fineness: float = FINENESS) -> Hull:
    """The spheroid as a chain with its radius at the links' ends and middles.

    The round ends touch the poles and join the spheroid where the radii are equal.
    """
    end = (1 - 1 / fineness**2) / (1 + 1 / fineness**2)
    x = end * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * _LINKS + 1))  # closer at the ends
    x[1::2] = (x[:-1:2] + x[2::2]) / 2
    radius = length / 2 / fineness * np.sqrt(1 - x**2)
    half = np.stack([radius[:-1:2], radius[1::2], radius[2::2]], axis=1)
    return Hull(length / 2 * np.diff(x[::2]), half, half)


def masses(length: int, wall: Wall, *, device: str = "cpu", threads: int = 2) -> Array:
    """Mass of body and added mass over the displaced mass, end-on and broadside.

    An oscillating force drives the free, neutrally buoyant body, in one box for each direction.
    Units are those of the lattice.
    """
    cells = tuple(round(side * length) for side in _SHAKEN)
    fluid = Fluid(D3Q19, cells, viscosity=_VISCOSITY, boxes=2, device=device, threads=threads)
    hull = prolate(float(length))
    links, volume = hull.length.size, np.pi / 6 * length**3 / FINENESS**2
    true = displaced(hull, 0.5, 0.0, False)
    true[:, [0, 2]] *= volume / true[:, 0].sum()
    weights = Masses(true[:, 0], true[:, 2], true[:, 1])
    bodies = Bodies(fluid, hull, weights, Units(1.0, 1.0, 1.0, 1.0), wall=wall)
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
        speed[:] = np.nan
    t = omega * np.arange(_PERIOD)
    basis = np.stack([np.cos(t), np.sin(t), np.ones_like(t), t], axis=1)
    fit = np.linalg.pinv(basis) @ speed[-_PERIOD:]
    return np.asarray(force / (omega * volume * np.hypot(fit[0], fit[1])))


def drag(
    length: int,
    wall: Wall,
    *,
    body: float = 1.0,
    degrees: float = 0.0,
    speed: float = SPEED,
    device: str = "cpu",
    threads: int = 2,
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
        device: Device of the fluid.
        threads: CPU threads of the fluid.
    """
    sides = _TOWED if degrees == 0 else _TOWED_ASKEW
    cells = tuple(round(side * length) for side in sides)
    fluid = Fluid(
        D3Q19, cells, viscosity=_VISCOSITY * speed / SPEED, smagorinsky=_SMAGORINSKY,
        device=device, threads=threads,
    )  # fmt: skip
    angle = np.deg2rad(degrees)
    ahead = np.array([np.cos(angle), np.sin(angle)])
    if body != 1.0:
        fluid.set(velocity=np.array([*((body - 1.0) * speed * ahead), 0.0]))
    hull, cell = prolate(LENGTH_M), LENGTH_M / length
    units = Units(cell, speed * cell / SPEED_M_S, cell)
    links = hull.length.size
    light = Masses(np.ones(links), np.ones(links), np.zeros(links))
    bodies = Bodies(fluid, hull, light, units, middle=(cells[2] - 1) / 2 + 0.1, wall=wall)
    place = np.array([cells[0] / 2, cells[1] / 2 + 0.2])
    if degrees:  # the middle of the path in that of the box
        place += ahead * length * (0.5 - 0.5 * body * _LENGTHS)
    start = np.zeros((1, 2 + links))
    start[0, :3] = *(cell * place), angle
    bodies.place(start)
    steps, ramp = round(_LENGTHS * length / speed), 0.1 * length / speed
    share = 0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, (np.arange(steps) + 1) / ramp))
    rates, force = np.zeros(2 + links), np.zeros(steps)
    for n in range(steps):
        rates[:2] = body * SPEED_M_S * share[n] * ahead
        bodies.prescribe(rates)
        bodies.step(HELD)
        force[n] = -(bodies.motion.force.numpy()[0, :, :2].sum(axis=0) @ ahead)
    if fluid.stopped.numpy()[0] >= 0:  # the flow broke down
        force[:] = np.nan
    unit = 0.5 * WATER_KG_M3 * SPEED_M_S**2 * wetted(LENGTH_M)
    return np.cumsum(share) * speed / length, force / unit


def steady(moved: Array, found: Array) -> float:
    """Mean over the second half of the way."""
    return float(found[moved > moved[-1] / 2].mean())


def friction(length: int, wall: Wall, *, device: str = "cpu", threads: int = 2) -> float:
    """Friction of a wall's line over the expected one, from the drag of tows with and without it.

    ``wall`` has a friction line. Expected is ``slipping() * plate()`` on the wetted area.
    """
    rough, bare = (
        steady(*drag(length, one, device=device, threads=threads))
        for one in (wall, replace(wall, line="none"))
    )
    return (rough - bare) / (slipping() * plate())


def frames(length: int, name: str, *, device: str = "cpu", threads: int = 2) -> list[Figure]:
    """Drag coefficient without friction in each frame, and the largest difference between them.

    Only that of ghost cells is judged; ``name`` is a wall's in ``WALLS``.
    """
    wall, thick = WALLS[name], round(length / FINENESS)
    bar = DRAG_BARS.get(thick) if wall.ghosts else None
    found = {
        frame: steady(
            *drag(length, wall, body=body, degrees=degrees, device=device, threads=threads)
        )
        for frame, (body, degrees) in FRAMES.items()
    }
    label = f"{name}, {thick} cells thick"
    figures = [
        Figure(f"drag coefficient without friction, {frame}, {label}", value, 0.0, bar, 1.0)
        for frame, value in found.items()
    ]
    apart = float(np.ptp(list(found.values())))
    quantity = f"largest difference between the frames, {label}"
    return [*figures, Figure(quantity, apart, 0.0, None if bar is None else _ALIKE, 1.0)]


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """48 cells long and 8 thick (24 and 4 if ``quick``, 96 and 16 on a GPU).

    Only the mass end-on is judged: the other two are off by more than a bar would allow. The
    frames of reference are compared at 4 cells of thickness (2 if ``quick``, also 8 and 16 on a
    GPU).
    """
    fine = device.startswith("cuda")
    length = 24 if quick else (96 if fine else 48)
    compared = (12,) if quick else ((24, 48, 96) if fine else (24,))
    k1, k2 = carried()
    along, across = masses(length, Wall(slip=True), device=device, threads=threads)
    (moved, with_line), (_, without) = (
        drag(length, Wall(True, line), device=device, threads=threads)
        for line in ("turbulent", "none")
    )
    found, reference = with_line - without, slipping() * plate()
    still = [
        figure
        for cells in compared
        for name in WALLS
        for figure in frames(cells, name, device=device, threads=threads)
    ]
    return Case(
        name="spheroid",
        title="Prolate spheroid along which water slips",
        source="Lamb, ARC R&M 623 (1918), Hydrodynamics (1932), art. 105, 114; ITTC 1957",
        setup=f"D3Q19, {length} cells long, {length / FINENESS:.0f} thick, periodic; shaken by "
        f"{_SWAY:g} cells, {_PERIOD} steps a period; towed {_LENGTHS:g} length at Re "
        f"{REYNOLDS:g}, {SPEED:g} cells a step",
        figures=(
            Figure("mass end-on over the displaced water's", float(along), 1 + k1, 0.1),
            Figure("mass broadside over the displaced water's", float(across), 1 + k2),
            Figure("friction end-on on the wetted area", steady(moved, found), reference),
            *still,
        ),
        curves=(
            Curve(
                "Friction end-on; reference: the line of 1957 with the ideal fluid's slip",
                "lengths towed", "friction coefficient", moved, found, moved[[0, -1]],
                np.full(2, reference),
            ),
        ),
    )  # fmt: skip
