"""Where a wall along which the water slips acts, against potential flow, for its three lengths.

    python benchmarks/wall_constants.py [--inset 0 0.2 0.4] [--edge 0.6 0.8 1.0] [--thin 0.3 0.7]
        [--ghost-edge 0.5 1.1]

A disc and a plate, nowhere special on the grid, are set in motion across their axis; their added
mass shows how large they seem. Printed: by how many cells a disc's radius and a plate's half
width seem too large, for each value that ``sim.fluid.wall`` could have, and with ghost cells for
each half-thickness of the plate: one whose half width seems too large by x needs a ``GHOST_EDGE``
that is larger by x.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product

import numpy as np

import sim.fluid.wall
from sim.fluid.fluid import Fluid
from sim.fluid.wall import GHOST_EDGE, Wall
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.shape import Hull

RADII, HALVES, HEADINGS = (3.0, 6.0, 12.0), (3.0, 6.0, 12.0), (0.0, 0.3, 0.785)
_THIN = 0.15
FORCED, GHOSTS = Wall(slip=True), Wall(slip=True, ghosts=True)


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--inset", type=float, nargs="*", default=[0.0, 0.2, 0.4])
    parser.add_argument("--edge", type=float, nargs="*", default=[0.6, 0.8, 1.0])
    parser.add_argument("--thin", type=float, nargs="*", default=[0.3, 0.7, 1.2])
    parser.add_argument("--ghost-edge", type=float, nargs="*", default=[GHOST_EDGE])
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    for inset in options.inset:
        sim.fluid.wall.INSET = inset
        print(f"inset {inset:g}: disc", *(f"{r:g} cells {disc(r, rng):+.2f}," for r in RADII))
    for edge in options.edge:
        sim.fluid.wall.EDGE = edge
        print(f"edge {edge:g}: plate", *(f"{h:g} cells {plate(h, rng):+.2f}," for h in HALVES))
    for edge, thin in product(options.ghost_edge, options.thin):
        wall = replace(GHOSTS, edge=edge)
        found = (f"{h:g} cells {plate(h, rng, thin, wall):+.2f}," for h in HALVES)
        print(f"ghost cells, edge {edge:g}, half-thickness {thin:g}: plate", *found)


def disc(radius: float, rng: np.random.Generator) -> float:
    """Cells by which a disc's radius seems too large; its images in the box are allowed for."""
    side = round(16 * radius)
    share = np.pi * radius**2 / side**2
    alone = np.pi * radius**2 * (1 + share) / (1 - share)
    found = np.mean([added(0.0, radius, 0.0, side, 0.01, rng) for _ in range(2)])
    return float(radius * (np.sqrt(found / alone) - 1))


def plate(half: float, rng: np.random.Generator, thin: float = _THIN, wall: Wall = FORCED) -> float:
    """Cells by which a thin plate's half width seems too large; its images are allowed for."""
    length, side = 2 * (half - thin), round(10 * half)
    found = np.mean([added(length, thin, a, side, 0.004, rng, wall) for a in HEADINGS])
    alone = found / (1 + found / (2 * side**2))
    return float(half * (np.sqrt(alone / (np.pi * half**2)) - 1))


def added(
    length: float,
    half_width: float,
    heading: float,
    side: int,
    speed: float,
    rng: np.random.Generator,
    wall: Wall = FORCED,
) -> float:
    """Area of water that goes along across the axis, from the force of an even acceleration."""
    half = np.full((1, 3), half_width)
    fluid = Fluid(D2Q9, (side, side), viscosity=3e-4, smagorinsky=0.17)
    light = Masses(np.ones(1), np.ones(1), np.full(1, length / 2))
    bodies = Bodies(
        fluid, Hull(np.array([length]), half, half), light, Units(1.0, 1.0, 1.0, 1.0),
        wall=wall,
    )  # fmt: skip
    x, y = side / 2 + rng.uniform(-0.5, 0.5, 2)
    bodies.place(np.array([[x, y, heading]]))
    across = np.array([-np.sin(heading), np.cos(heading)])
    steps = round(24 * max(length / 2, half_width))
    force = np.zeros(steps)
    for k in range(steps):
        bodies.prescribe(np.append(speed * (k + 1) / steps * across, 0.0))
        bodies.step(HELD)
        force[k] = bodies.motion.force.numpy()[0, 0, :2] @ across
    return float(-force[steps // 4 :].mean() * steps / speed)


if __name__ == "__main__":
    main()
