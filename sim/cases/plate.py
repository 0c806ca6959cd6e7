"""Sharp-edged plates across the stream: the drag of a square one and of an infinitely long one.

Source: Hoerner, Fluid-Dynamic Drag (1965), chapter 3: 1.17 and 1.98 on the plate's area, at
Reynolds numbers of 1e4 and more. Flow past the long plate is computed in two dimensions; in water
its wake is three-dimensional, so that the two need not agree.

Hoerner's cylinders with their axis along the stream are no case: thick links have round ends, only
parts that are thinner than the grid resolves end sharply (``sim/fluid/section.py``).
"""

from __future__ import annotations

from functools import partial
from itertools import product

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.cases.walls import WALLS
from sim.fluid.fluid import Fluid
from sim.fluid.wall import Wall
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9, D3Q19
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.shape import Hull
from sim2real.arrays import Array

SQUARE, LONG = 1.17, 1.98
"""Drag coefficients."""
_SPEED = 0.05
"""Towing speed in cells per step."""


def drag(
    side: int,
    wall: Wall,
    *,
    lengths: float = 10.0,
    long: bool = False,
    device: str = "cpu",
    threads: int = 2,
) -> tuple[Array, Array]:
    """Sides moved and drag coefficient of a plate one cell thick, at each step.

    Args:
        side: Cells along its side.
        wall: The wall model.
        lengths: Sides that it is towed; its speed grows over the first.
        long: Whether it is infinitely long, and the flow in two dimensions.
        device: Device of the fluid.
        threads: CPU threads of the fluid.
    """
    path = round((lengths + 6) * side)
    cells = (path, 24 * side) if long else (path, 6 * side, 6 * side)
    fluid = Fluid(
        D2Q9 if long else D3Q19, cells, viscosity=3e-4, smagorinsky=0.17, device=device,
        threads=threads,
    )  # fmt: skip
    hull = Hull(np.array([side - 1.0]), np.full((1, 3), 0.5), np.full((1, 3), side / 2))
    light = Masses(np.ones(1), np.ones(1), np.zeros(1))
    middle = (cells[-1] - 1) / 2 + 0.1
    bodies = Bodies(fluid, hull, light, Units(1.0, 1.0, 1.0, 1.0), middle=middle, wall=wall)
    bodies.place(np.array([[3.0 * side + 0.2, cells[1] / 2 + side / 2, np.pi / 2]]))
    steps = round(lengths * side / _SPEED)
    share = np.minimum(1.0, np.arange(steps) * _SPEED / side)
    force = np.zeros(steps)
    for n in range(steps):
        bodies.prescribe(np.array([_SPEED * share[n], 0.0, 0.0]))
        bodies.step(HELD)
        force[n] = -bodies.motion.force.numpy()[0, :, 0].sum()
    if fluid.stopped.numpy()[0] >= 0:  # the flow broke down
        force[:] = np.nan
    area = side if long else side**2
    return np.cumsum(share) * _SPEED / side, force / (0.5 * _SPEED**2 * area)


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """5 cells a side on a CPU, 12 and 24 on a GPU, where ghost cells have a bar.

    The square plate is judged in each third of the second half of its way. The long one is towed on
    a GPU only: its wake is symmetric for the first 30 to 50 sides, and then sheds vortices. If
    ``quick`` there are both, too short for the figures to mean anything.
    """
    fine = device.startswith("cuda")
    sides = (12, 24) if fine else (5,)
    sides, lengths, far = ((4,), 3.0, 3.0) if quick else (sides, 10.0, 120.0)
    towed = partial(drag, device=device, threads=threads)
    figures, curves = [], []
    for side, name in product(sides, WALLS):
        wall, label = WALLS[name], f"{name}, {side} cells"
        moved, found = towed(side, wall, lengths=lengths)
        bar = 0.1 if fine and wall.ghosts else None
        second = [np.array_split(values[found.size // 2 :], 3) for values in (moved, found)]
        for way, values in zip(*second, strict=True):
            quantity = f"drag coefficient of a square plate after {way[0]:.1f} sides, {label}"
            figures.append(Figure(quantity, float(values.mean()), SQUARE, bar))
        curves.append(_curve(f"Square plate, {label}", moved, found, SQUARE))
    for name in WALLS if fine or quick else ():
        label = f"{name}, {sides[0]} cells"
        moved, found = towed(sides[0], WALLS[name], lengths=far, long=True)
        mean = float(found[found.size // 2 :].mean())
        figures.append(Figure(f"drag coefficient of a long plate, {label}", mean, LONG))
        curves.append(_curve(f"Long plate, {label}", moved, found, LONG))
    return Case(
        name="plate",
        title="Sharp-edged plates across the stream",
        source="Hoerner, Fluid-Dynamic Drag (1965), chapter 3",
        setup=f"one cell thick, towed {lengths:g} sides at {_SPEED:g} cells a step, box 6 sides "
        f"wide and high; the long plate in D2Q9, {far:g} sides, 24 wide; second half of the way",
        figures=tuple(figures),
        curves=tuple(curves),
    )


def _curve(title: str, moved: Array, found: Array, reference: float) -> Curve:
    """Drag coefficient after the first side, in sixty means."""
    parts = (np.array_split(values[moved > 1], 60) for values in (moved, found))
    x, y = (np.array([part.mean() for part in values]) for values in parts)
    return Curve(title, "sides towed", "drag coefficient", x, y, x[[0, -1]], np.full(2, reference))
