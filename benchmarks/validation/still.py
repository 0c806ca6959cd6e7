"""Water at rest: vortices that decay, a cylinder that is shaken, a sphere that sinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import kv

from benchmarks.validation.case import CPU, LATTICE, Case, Figure, Where, amplitude, ball
from sim.fluid.fluid import CS2, Fluid
from sim.lattice.cell import SLIP, SOLID
from sim.lattice.velocities import D2Q9, D3Q19, Lattice, Units
from sim.robot.bodies import VIRTUAL_MASS, Bodies, Masses, inset_at
from sim2real.arrays import Array

_PLANES = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}
_VISCOSITY = 0.1
_SPEED, _COARSEST = 0.04, 16
"""Of the vortices: largest speed in cells per step in the coarsest box; proportional to the size of
the cells, so that the compressibility error falls with its square too."""
_LOOKS = 40


def vortices(size: int, t: float, plane: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Density, velocity and strain rate at t steps, one vortex pair each way: axes as in ``Fluid``.

    Args:
        size: Cells per side.
        t: Steps since the start.
        plane: The two axes of the velocity; the flow is uniform along the third.
    """
    first, second = plane
    k = 2 * np.pi / size
    shape = [1, 1, 1, 1]
    shape[1 + first] = shape[1 + second] = size
    grid = np.indices(shape)
    x, y = k * grid[1 + first], k * grid[1 + second]
    U = _SPEED * _COARSEST / size * np.exp(-2 * _VISCOSITY * k * k * t)
    u, strain = np.zeros((*shape, 3)), np.zeros((*shape, 6))
    u[..., first], u[..., second] = U * np.sin(x) * np.cos(y), -U * np.cos(x) * np.sin(y)
    strain[..., first] = k * U * np.cos(x) * np.cos(y)
    strain[..., second] = -strain[..., first]  # the shear strain of this flow is zero
    density = 1 + U * U / 4 / CS2 * (np.cos(2 * x) + np.cos(2 * y))
    return density, u, strain


def decay(lattice: Lattice, size: int, plane: str, where: Where = CPU) -> tuple[float, float]:
    """Relative error of the velocity until half of it is left, and viscosity over the nominal one.

    The error is the root of the mean square over all cells and over times spread evenly: the start
    sets off faint sound, which at one moment may be near its zero. The viscosity is that of the
    energy's decay.
    """
    axes = _PLANES[plane]
    density, start, strain = vortices(size, 0.0, axes)
    fluid = where.fluid(lattice, start.shape[1:4], viscosity=_VISCOSITY)
    fluid.set(density, start, strain)
    rate = 2 * _VISCOSITY * (2 * np.pi / size) ** 2
    times = np.unique(np.linspace(0, np.log(2) / rate, _LOOKS + 1).round().astype(int))
    ours, squares, steps = start, 0.0, np.diff(times)
    for t, count in zip(times[1:], steps, strict=True):
        fluid.step(int(count))
        ours, exact = fluid.moments()[1].astype(np.float64), vortices(size, float(t), axes)[1]
        squares += float(np.sum((ours - exact) ** 2) / np.sum(exact**2))
    found = np.log(np.sum(start**2) / np.sum(ours**2)) / 2 / times[-1]
    return float(np.sqrt(squares / steps.size)), float(found / rate)


def taylor_green(where: Where = CPU) -> Case:
    """Order of convergence and viscosity, of both lattices and all planes of the second."""
    sizes = np.array([16, 32] if where.quick else [16, 32, 64, 128])
    figures = []
    for lattice, plane in ((D2Q9, "xy"), (D3Q19, "xy"), (D3Q19, "yz"), (D3Q19, "zx")):
        found = np.array([decay(lattice, int(n), plane, where) for n in sizes])
        order = -np.polyfit(np.log(sizes), np.log(found[:, 0]), 1)[0]
        of = f"{lattice.name}, {plane}"
        figures += [
            Figure(f"order of convergence ({of})", float(order), 2.0, 0.05),
            Figure(f"viscosity over nominal, {sizes[1]} cells ({of})", found[1, 1], 1.0, 0.01),
        ]
    return Case(
        "Taylor-Green vortices decay in a periodic box",
        "exact: Taylor and Green, Proc. R. Soc. Lond. A 158 (1937) 499",
        f"{sizes[0]} to {sizes[-1]} cells a side, viscosity {_VISCOSITY:g}, speed {_SPEED:g} at "
        f"{_COARSEST} cells falling as the cells, until half is left",
        figures,
    )


RATIOS = (0.5, 0.9, 1.0, 1.1, 2.0, 10.0)
"""Densities of the driven cylinder over that of the water."""
_NU, _PERIOD, _PERIODS = 0.02, 2000, 4
_SHAKEN, _SIDE = 0.01, 6
"""Speed in cells a step, and side of a box in diameters."""


def driving_force(radius: float) -> float:
    """Amplitude of the force per depth in lattice units, which sets the speed."""
    return float(2 * np.pi * radius**2 * _SHAKEN * 2 * np.pi / _PERIOD)


def stokes_speed(radius: float, ratio: float, side: float) -> float:
    """Amplitude of the speed of a cylinder in a square periodic box, in cells a step.

    In unbounded fluid at rest the force of the fluid is -i w rho pi a^2 U C, with
    C = 1 + 4 K1(la) / (la K0(la)), l^2 = i w / nu. Outside its boundary layer the cylinder is a
    doublet, as if it moved in ideal fluid at U (1 + C) / 2. In the box the driving force F moves
    the whole, so that the mean flow is F / (i w rho) - (ratio - 1) pi a^2 U over the area, which is
    c (1 + C) U with c = pi a^2 / side^2; the images' doublets take half of it back (the local field
    of a square array). The cylinder is thus in a stream of u = c (1 + C) U / 2, which pushes it
    with i w rho pi a^2 (1 + C) u: correct to first order in c.
    """
    omega = 2 * np.pi / _PERIOD
    la = radius * np.sqrt(1j * omega / _NU)
    area = np.pi * radius**2
    c = 1 + 4 * kv(1, la) / (la * kv(0, la))
    mass = area * (ratio + c - area / side**2 * (1 + c) ** 2 / 2)
    return float(abs(driving_force(radius) / (omega * mass)))


def shaken(diameter: int, side: int, ratios: Sequence[float], where: Where = CPU) -> Array:
    """Amplitude of the speed over the last two periods, one box for each ratio."""
    radius = diameter / 2
    fluid = where.fluid(D2Q9, (side, side), viscosity=_NU, boxes=len(ratios))
    mass = np.array(ratios)[:, None] * np.pi * radius**2
    masses = Masses(mass, mass * radius**2 / 2, np.zeros_like(mass))
    bodies = Bodies(fluid, ball(radius), masses, LATTICE, inset=inset_at(_NU))
    start = np.zeros((len(ratios), 3))
    start[:, :2] = side / 2 + 0.3  # a generic position on the grid
    bodies.place(start)
    push = np.zeros_like(start)
    speed: list[Array] = []
    for step in range(_PERIODS * _PERIOD):
        push[:, 0] = driving_force(radius) * np.cos(2 * np.pi * (step + 0.5) / _PERIOD)
        bodies.push(push)
        bodies.step()
        speed.append(bodies.motion.v.numpy()[:, 0].copy())
    return amplitude(np.array(speed[-2 * _PERIOD :]), _PERIOD)


def driven_cylinder(where: Where = CPU) -> Case:
    """A free cylinder, 32 cells wide (16 if quick), driven by an oscillating force."""
    diameter, ratios = (16, (1.0,)) if where.quick else (32, RATIOS)
    side = _SIDE * diameter
    figures = [
        Figure(f"speed at density ratio {ratio:g}, cells a step", float(ours), exact, 0.03)
        for ratio, ours in zip(ratios, shaken(diameter, side, ratios, where), strict=True)
        if (exact := stokes_speed(diameter / 2, ratio, side))
    ]
    return Case(
        "Free cylinder driven in still water",
        "Stokes, Trans. Camb. Phil. Soc. 9 (1851) 8; closed form with Bessel functions",
        f"D = {diameter} cells, {side} x {side} cells, periodic (the reference is corrected for "
        f"it), viscosity {_NU}, {_PERIOD} steps a period, {_PERIODS} periods",
        figures,
    )


DIAMETER_M, DENSITY = 0.015, 1120.0
"""Of the settling sphere."""
TANK_M = (0.16, 0.1, 0.1)
"""Height, width, width."""
GAP_M = 0.12
"""Distance of the tank's bottom and the sphere's lowest point at the start."""
_WALL, _HALVES = 1, 2.0


@dataclass(frozen=True)
class Liquid:
    """One of the experiments with the settling sphere.

    Attributes:
        name: Name in the paper.
        density: In kg/m3.
        viscosity: Dynamic, in Pa s.
        speed: Largest speed measured, in m/s.
        fastest: Largest speed in cells per step, which sets the step: less for viscous liquids.
    """

    name: str
    density: float
    viscosity: float
    speed: float
    fastest: float


LIQUIDS = (
    Liquid("E1", 970.0, 0.373, 0.035986, 0.02),
    Liquid("E2", 965.0, 0.212, 0.05718, 0.03),
    Liquid("E3", 962.0, 0.113, 0.087269, 0.04),
    Liquid("E4", 960.0, 0.058, 0.12224, 0.05),
)


def settle(liquid: Liquid, diameter: int, where: Where = CPU) -> float:
    """Largest speed in m/s before the sphere slows down above the bottom.

    It falls along x. By symmetry only half the tank is simulated. For half the water to carry the
    whole sphere, water has twice its density, and the sphere has additional mass to compensate.
    """
    cell = DIAMETER_M / diameter
    units = Units(cell, liquid.fastest * cell / liquid.speed, cell, _HALVES * liquid.density)
    high, wide = (round(side / cell) for side in TANK_M[:2])
    size = (high + _WALL, wide + _WALL, wide // 2 + 2)
    walls, normals = np.zeros(size, np.uint8), np.zeros(size, np.int32)
    walls[:, :, 0], normals[:, :, 0] = SLIP, 5
    walls[0] = walls[:, 0] = SOLID
    walls[:, :, -1] = SOLID
    viscosity = units.viscosity_lu(liquid.viscosity / liquid.density)
    fluid = where.fluid(D3Q19, size, viscosity=viscosity, walls=walls, normals=normals)
    bodies = _sphere(fluid, units, inset_at(viscosity))
    middle = 0.5 * cell + wide * cell / 2
    bodies.place(np.array([[0.5 * cell + GAP_M + DIAMETER_M / 2, middle, 0.0]]))
    volume = np.pi / 6 * DIAMETER_M**3
    bodies.push(np.array([-(DENSITY - liquid.density) * 9.81 * volume, 0.0, 0.0]))
    every = max(1, round(0.005 / units.step_s))
    speeds = [0.0]
    while speeds[-1] > 0.97 * max(speeds) or len(speeds) < 5:
        for _ in range(every):
            bodies.step()
        speeds.append(-float(bodies.motion.v.numpy()[0, 0]))
    return max(speeds)


def _sphere(fluid: Fluid, units: Units, inset: float) -> Bodies:
    """The whole sphere in half the water, with the net and virtual mass of the whole tank."""
    hull, true = ball(DIAMETER_M / 2), DENSITY * np.pi / 6 * DIAMETER_M**3
    light = Masses(np.array([true]), np.array([0.1 * true * DIAMETER_M**2]), np.zeros(1))
    twice = Bodies(fluid, hull, light, units, inset=inset).displaced[0]
    more = 1 - 1 / _HALVES
    mass, inertia = light.mass + more * twice[0], light.inertia + more * twice[2]
    virtual = VIRTUAL_MASS / _HALVES
    whole = Masses(mass, inertia, light.com)
    return Bodies(fluid, hull, whole, units, middle=0.5, inset=inset, virtual_mass=virtual)


def settling_sphere(where: Where = CPU) -> Case:
    """All four liquids; if quick only the least viscous, with a coarse sphere."""
    diameter = 6 if where.quick else (24 if where.gpu else 13)
    bar = 0.15 if where.quick else 0.04
    return Case(
        "Sphere settling in a tank, Re 1.5 to 32",
        "ten Cate, Nieuwstad, Derksen, Van den Akker, Phys. Fluids 14 (2002) 4012, cases E1 to E4 "
        "(measured by particle image velocimetry)",
        f"D3Q19, {diameter} cells a diameter, no-slip tank of 100 x 100 x 160 mm, half of it "
        "computed, density ratio 1.15 to 1.17",
        [
            Figure(
                f"{one.name}: largest speed in m/s", settle(one, diameter, where), one.speed, bar
            )
            for one in (LIQUIDS[-1:] if where.quick else LIQUIDS)
        ],
    )
