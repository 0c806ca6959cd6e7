"""A sphere slightly denser than the liquid sinks in a tank: its largest speed.

Source of the references: ten Cate, Nieuwstad, Derksen, Van den Akker, Phys. Fluids 14 (2002) 4012,
cases E1 to E4 (measured by particle image velocimetry).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import Fluid
from sim.lattice.cell import SLIP, SOLID
from sim.lattice.units import Units
from sim.lattice.velocities import D3Q19
from sim.robot.bodies import VIRTUAL_MASS, Bodies, Masses, inset_at
from sim.robot.shape import Hull
from sim2real.arrays import Array

DIAMETER_M, DENSITY = 0.015, 1120.0
TANK_M = (0.16, 0.1, 0.1)
"""Height, width, width."""
GAP_M = 0.12
"""Distance of the tank's bottom and the sphere's lowest point at the start."""
GRAVITY = 9.81
_WALL, _HALVES = 1, 2.0


@dataclass(frozen=True)
class Liquid:
    """One of the experiments.

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


def settle(
    liquid: Liquid, diameter: int, *, device: str = "cpu", threads: int = 2
) -> tuple[Array, Array]:
    """Times in s and speeds in m/s until the sphere slows down before the bottom.

    It falls along x. By symmetry only half the tank is simulated. For half the water to carry the
    whole sphere, water has twice its density, and the sphere has additional mass to compensate.
    """
    cell = DIAMETER_M / diameter
    units = Units(cell, liquid.fastest * cell / liquid.speed, cell, _HALVES * liquid.density)
    high, wide = (round(side / cell) for side in TANK_M[:2])
    size = (high + _WALL, wide + _WALL, wide // 2 + 2)
    walls, normals = np.zeros(size, np.uint8), np.zeros(size, np.int32)
    walls[:, :, 0], normals[:, :, 0] = SLIP, 5
    walls[0] = SOLID
    walls[:, 0] = SOLID
    walls[:, :, -1] = SOLID
    viscosity = units.viscosity_lu(liquid.viscosity / liquid.density)
    fluid = Fluid(
        D3Q19,
        size,
        viscosity=viscosity,
        walls=walls,
        normals=normals,
        device=device,
        threads=threads,
    )
    radius = np.full((1, 3), DIAMETER_M / 2)
    hull = Hull(np.zeros(1), radius, radius)
    bodies = _sphere(fluid, hull, units, inset_at(viscosity))
    middle = 0.5 * cell + wide * cell / 2
    bodies.place(np.array([[0.5 * cell + GAP_M + DIAMETER_M / 2, middle, 0.0]]))
    volume = np.pi / 6 * DIAMETER_M**3
    bodies.push(np.array([-(DENSITY - liquid.density) * GRAVITY * volume, 0.0, 0.0]))
    every = max(1, round(0.005 / units.step_s))
    times, speeds = [0.0], [0.0]
    while speeds[-1] > 0.97 * max(speeds) or len(speeds) < 5:
        for _ in range(every):
            bodies.step()
        times.append(times[-1] + every * units.step_s)
        speeds.append(-float(bodies.motion.v.numpy()[0, 0]))
    return np.array(times), np.array(speeds)


def _sphere(fluid: Fluid, hull: Hull, units: Units, inset: float) -> Bodies:
    """The whole sphere in half the water, with the net and virtual mass of the whole tank."""
    true = DENSITY * np.pi / 6 * DIAMETER_M**3
    light = Masses(np.array([true]), np.array([0.1 * true * DIAMETER_M**2]), np.zeros(1))
    twice = Bodies(fluid, hull, light, units, inset=inset).displaced[0]
    more = 1 - 1 / _HALVES
    mass, inertia = light.mass + more * twice[0], light.inertia + more * twice[2]
    return Bodies(
        fluid,
        hull,
        Masses(mass, inertia, light.com),
        units,
        middle=0.5,
        inset=inset,
        virtual_mass=VIRTUAL_MASS / _HALVES,
    )


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """All four liquids; with ``quick`` only the least viscous, with a coarse sphere."""
    diameter = 6 if quick else (24 if device.startswith("cuda") else 13)
    liquids = LIQUIDS[-1:] if quick else LIQUIDS
    figures, curves = [], []
    for liquid in liquids:
        times, speeds = settle(liquid, diameter, device=device, threads=threads)
        name = f"{liquid.name}: largest speed in m/s"
        figures.append(Figure(name, float(speeds.max()), liquid.speed, 0.15 if quick else 0.04))
        curves.append(
            Curve(
                f"{liquid.name}; reference: largest speed measured", "time (s)", "speed (m/s)",
                times, speeds, times[[0, -1]], np.full(2, liquid.speed),
            )
        )  # fmt: skip
    return Case(
        name="settling_sphere",
        title="Sphere settling in a tank, Re 1.5 to 32",
        source="ten Cate et al., Phys. Fluids 14 (2002) 4012, cases E1 to E4",
        setup=f"D3Q19, {diameter} cells a diameter, no-slip tank of 100 x 100 x 160 mm, half of it "
        "computed, density ratio 1.15 to 1.17",
        figures=tuple(figures),
        curves=tuple(curves),
    )
