"""A three-joint robot with a travelling wave, and gaits that must not propel it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import Fluid
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import INSET, KINEMATIC, Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim2real.arrays import Array

RADII = (0.085, 0.115, 0.06, 0.025, 0.01)
"""Half-widths at the nose, the joints and the tail's tip, in body lengths."""
AMPLITUDE = (0.45, 0.60, 0.75)
LAG = 1.2 * np.arange(3)
REYNOLDS = 1000.0
"""Body length times body length a cycle, over the viscosity."""
HEADINGS = (0.0, 0.4, np.pi / 4, 1.2, np.pi / 2)
_BOX = 80 / 13
_STEPS = 52
_SMAGORINSKY = 0.1
_CYCLES, _COUNTED = 7, 3


class Bending(Protocol):
    """Joint angles of a robot over time, and its initial heading."""

    @property
    def heading(self) -> float:
        """In rad."""

    def joints(self, t: float) -> Array:
        """Joint angles in rad at t cycles."""


@dataclass(frozen=True)
class Gait:
    """Joint angles of one robot over time, and its initial heading.

    Attributes:
        heading: In rad.
        wave: 1 for a wave towards the tail, -1 towards the head, 0 in phase.
        side: -1 for the mirror image.
        turn: Offset of all joints in rad.
        amplitude: Amplitude of each joint in rad.
    """

    heading: float = 0.0
    wave: float = 1.0
    side: float = 1.0
    turn: float = 0.0
    amplitude: tuple[float, ...] = AMPLITUDE

    def joints(self, t: float) -> Array:
        """Joint angles in rad at t cycles, growing over the first."""
        bend = np.array(self.amplitude) * np.sin(2 * np.pi * t - self.wave * LAG) + self.turn
        return np.asarray(self.side * min(1.0, t) * bend)


@dataclass(frozen=True)
class SwimPath:
    """Paths of robots: cycles (T,), x, y and heading of the head (T, E, 3), in body lengths."""

    cycles: Array
    path: Array

    def speed(self) -> Array:
        """Body lengths a cycle over the last cycles, shape (E,)."""
        moved = (self.path[-1] - self.path[-1 - _COUNTED])[:, :2]
        return np.asarray(np.linalg.norm(moved, axis=1) / _COUNTED)

    def advance(self) -> Array:
        """Body lengths a cycle along the mean heading over the last cycles, shape (E,)."""
        last = self.path[-1 - _COUNTED :]
        heading = last[:, :, 2].mean(axis=0)
        moved = (last[-1] - last[0])[:, :2] / _COUNTED
        return np.asarray(moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading))


def swim(
    gaits: Sequence[Bending],
    cells: int,
    *,
    radii: Sequence[float] | Array = RADII,
    reynolds: float | Array = REYNOLDS,
    inset: float = INSET,
    smagorinsky: float = _SMAGORINSKY,
    box: tuple[float, float] = (_BOX, _BOX),
    steps: int | None = None,
    cycles: int = _CYCLES,
    device: str = "cpu",
    threads: int = 2,
) -> SwimPath:
    """Simulate robots of one shape with prescribed joints, each in a box of still water.

    Args:
        gaits: One for each robot.
        cells: Cells a body length.
        radii: Half-widths at nose, joints and tip in body lengths.
        reynolds: Reynolds number, one or one for each robot.
        inset: Distance in cells by which the surface is moved inwards.
        smagorinsky: Constant of the sub-grid viscosity.
        box: Sides of a box in body lengths.
        steps: Steps per cycle; ``_STEPS`` for each cell where None.
        cycles: Number of cycles.
        device: Warp device.
        threads: CPU threads.
    """
    cell = 1.0 / cells
    steps = _STEPS * cells if steps is None else steps
    r = np.asarray(radii)
    half = np.stack([r[:-1], (r[:-1] + r[1:]) / 2, r[1:]], axis=1)
    links = r.size - 1
    hull = Hull(np.full(links, (1 - r[0] - r[-1]) / links), half, half)
    units = Units(cell, 1.0 / steps, 1.0, 1000.0)
    size = round(box[0] * cells), round(box[1] * cells)
    fluid = Fluid(
        D2Q9,
        size,
        boxes=len(gaits),
        viscosity=units.viscosity_lu(1.0) / np.asarray(reynolds),
        smagorinsky=smagorinsky,
        device=device,
        threads=threads,
    )
    true = displaced(hull, cell, 0.0, True)
    masses = Masses(1000 * true[:, 0], 1000 * true[:, 2], true[:, 1])
    bodies = Bodies(fluid, hull, masses, units, inset=inset)
    start = np.zeros((len(gaits), 2 + links))
    start[:, 2] = [gait.heading for gait in gaits]
    ahead = hull.length.sum() / 2 - true[0, 1]
    for axis, side in enumerate(size):  # between cells, about which the grid is symmetric
        start[:, axis] = (side // 2 - 0.5) * cell + ahead * np.cos(start[:, 2] - axis * np.pi / 2)
    start[:, 3:] = [gait.joints(0.0) for gait in gaits]
    bodies.place(start)
    path = [start[:, :3]]
    before = start[:, 3:]
    rates = np.zeros_like(start)
    for step in range(cycles * steps):
        after = np.array([gait.joints((step + 1) / steps) for gait in gaits])
        rates[:, 3:] = (after - before) * steps
        before = after
        bodies.prescribe(rates)
        bodies.step(KINEMATIC)
        if (step + 1) % steps == 0:
            path.append(bodies.motion.q.numpy()[:, :3].copy())
    return SwimPath(np.arange(cycles + 1.0), np.array(path))


SYMMETRIC = (0.06, 0.06, 0.06, 0.06, 0.06)
"""Half-widths of a body that is symmetric front to back."""
_FLAP = Gait(wave=0.0, amplitude=(0.6, 0.6, 0.6))


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """All headings at two resolutions, three on CUDA, and gaits that must not propel the robot.

    The refinement from 52 to 104 cells takes minutes on a GPU, and is omitted on a CPU.
    """
    fine = 26 if quick else 52
    cycles = 4 if quick else _CYCLES
    straight = [Gait(heading=h) for h in HEADINGS]
    others = [Gait(wave=-1.0), Gait(side=-1.0), Gait(turn=0.1), Gait(turn=0.1, side=-1.0)]

    def simulated(gaits: Sequence[Gait], cells: int, **more: Any) -> SwimPath:  # noqa: ANN401
        return swim(gaits, cells, cycles=cycles, device=device, threads=threads, **more)

    main = simulated([*straight, *others], fine)
    flap = simulated([_FLAP], fine, radii=SYMMETRIC)
    speed, mean = main.speed(), float(main.speed()[: len(straight)].mean())
    figures = [
        _heading(h, fine, v, mean, 0.15 if quick else 0.05)
        for h, v in zip(HEADINGS, speed, strict=False)
    ]
    reverse, _, left, right = (k + len(straight) for k in range(4))
    turned = main.path[-1, :, 2]
    drift = float(flap.speed()[0]) / mean
    forward = float(main.advance()[: len(straight)].mean())
    figures += [
        Figure("swims head first: advance over speed", forward / mean, 1.0, 0.15),
        _residual("reversed wave, share of the speed", float(speed[reverse]) / mean, 1 / 3),
        _residual("in-phase flap of a symmetric body", drift, 0.1 if quick else 0.05),
        _residual("turn of the mirror image, rad", float(turned[right] + turned[left]), 0.02),
    ]
    curves = [_speeds(f"{fine} cells", np.array(HEADINGS), speed[: len(straight)])]
    if not quick:
        coarse = simulated(straight, 26).speed()
        level = float(coarse.mean())
        figures += [_heading(h, 26, v, level, 0.15) for h, v in zip(HEADINGS, coarse, strict=True)]
        figures.append(Figure("26 against 52 cells, body lengths a cycle", level, mean))
        curves.append(_speeds("26 cells", np.array(HEADINGS), coarse))
    if device != "cpu" and not quick:
        finest = float(simulated(straight[:1], 104).speed()[0])
        name = "52 against 104 cells, body lengths a cycle"
        figures.append(Figure(name, float(speed[0]), finest, 0.15))
    return Case(
        name="swimming",
        title="A three-joint robot under a travelling wave",
        source="the robot's own symmetry; fluid.md's trials for scale (0.24 to 0.25 at 52 cells)",
        setup=f"{fine} cells a body length, Re {REYNOLDS:g}, density ratio 1, {cycles} cycles",
        figures=tuple(figures),
        curves=tuple(curves),
    )


def _residual(quantity: str, ours: float, bar: float) -> Figure:
    return Figure(quantity, ours, 0.0, bar, scale=1.0)


def _heading(heading: float, cells: int, ours: float, mean: float, bar: float) -> Figure:
    name = f"speed at {heading:.2f} rad, {cells} cells, body lengths a cycle, against the mean"
    return Figure(name, float(ours), mean, bar)


def _speeds(label: str, heading: Array, speed: Array) -> Curve:
    return Curve(f"Speed, {label}", "heading (rad)", "speed (body lengths a cycle)", heading, speed)
