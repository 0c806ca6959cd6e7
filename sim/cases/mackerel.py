"""A mackerel with a prescribed wave, towed: the Strouhal number at which thrust balances drag.

Source: Borazjani and Sotiropoulos, J. Exp. Biol. 211 (2008) 1541. Without viscosity, the number
approaches that of carangiform fish in nature, about 0.25; at Reynolds numbers of 300 and 4000 it is
far larger. So water that slips along the body must give about 0.25 without friction. The wave is
theirs, after Videler and Hess, J. Exp. Biol. 109 (1984) 209: the lateral displacement is
0.02 - 0.08 s + 0.16 s^2 body lengths at s from the nose, the wavelength 0.95. The body here is
round in its sections with the proportions of a mackerel, so the answer is known only roughly.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.cases.walls import WALLS
from sim.fluid.fluid import Fluid
from sim.fluid.wall import Wall
from sim.lattice.units import Units
from sim.lattice.velocities import D3Q19
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.shape import Hull
from sim2real.arrays import Array

STROUHAL = 0.25
_BAR = 0.28
"""The Strouhal number may be 0.18 to 0.32: the body is only roughly theirs."""
TRIED = (0.18, 0.22, 0.27, 0.34)
"""Strouhal numbers at which the body is towed."""
LINKS = 16
_ENVELOPE = (0.02, -0.08, 0.16)
_WAVELENGTH = 0.95
_PLACES = (0.0, 0.08, 0.2, 0.4, 0.6, 0.75, 0.86, 0.93, 1.0)
_HALF_WIDTH = (0.02, 0.04, 0.055, 0.062, 0.05, 0.03, 0.012, 0.006, 0.004)
_HALF_HEIGHT = (0.03, 0.06, 0.08, 0.09, 0.075, 0.045, 0.02, 0.06, 0.10)
"""Sizes at places from nose to tail, in body lengths: a head, a peduncle and a fin."""
_BOX = (4.0, 1.0, 0.8)
_CYCLES, _COUNTED = 4, 2
_STEPS = 12
"""Steps of a cycle for each cell of a body length: the tip moves 0.05 cells a step."""


def deflection(s: Array | float, t: float) -> Array:
    """Lateral displacement of the midline in body lengths at t cycles; grows over the first."""
    size = np.polynomial.polynomial.polyval(s, _ENVELOPE)
    growth = np.sin(np.pi / 2 * min(1.0, t))
    return np.asarray(growth * size * np.sin(2 * np.pi * (s / _WAVELENGTH - t)))


def hull(cells: int) -> Hull:
    """The body in cells, ``cells`` long."""
    nose, tip = _HALF_WIDTH[0], _HALF_WIDTH[-1]
    ends = np.linspace(nose, 1 - tip, LINKS + 1)
    places = np.stack([ends[:-1], (ends[:-1] + ends[1:]) / 2, ends[1:]], axis=1)
    wide, high = (
        cells * np.interp(places, _PLACES, profile) for profile in (_HALF_WIDTH, _HALF_HEIGHT)
    )
    return Hull(cells * np.diff(ends), wide, high)


@dataclass(frozen=True)
class Tow:
    """Forces on a towed body that beats, over its last cycles.

    Attributes:
        strouhal: Frequency times the tail's excursion over the speed of each tow, shape (E,).
        thrust: Mean force along the tow over half the density times the squares of speed and body
            length, shape (E,); NaN where the box stopped.
    """

    strouhal: Array
    thrust: Array

    @property
    def balance(self) -> float:
        """Strouhal number at which the mean force is zero, by linear interpolation."""
        crossings = np.flatnonzero(np.diff(np.sign(self.thrust)) > 0)
        if crossings.size == 0:
            return float("nan")
        k = int(crossings[0])
        share = -self.thrust[k] / (self.thrust[k + 1] - self.thrust[k])
        return float(self.strouhal[k] + share * (self.strouhal[k + 1] - self.strouhal[k]))


def tow(
    cells: int,
    wall: Wall,
    *,
    strouhal: tuple[float, ...] = TRIED,
    cycles: int = _CYCLES,
    device: str = "cpu",
    threads: int = 2,
) -> Tow:
    """Tow the beating body at each Strouhal number, in a periodic box each."""
    body, E, N = hull(cells), len(strouhal), 2 + LINKS
    size = tuple(round(side * cells) for side in _BOX)
    fluid = Fluid(
        D3Q19, size, boxes=E, viscosity=3e-4, smagorinsky=0.17, device=device, threads=threads
    )
    light = Masses(np.ones(LINKS), np.ones(LINKS), np.zeros(LINKS))
    middle = (size[2] - 1) / 2 + 0.1
    bodies = Bodies(fluid, body, light, Units(1.0, 1.0, 1.0, 1.0), middle=middle, wall=wall)
    steps = _STEPS * cells
    advance = 2 * sum(_ENVELOPE) * cells / np.array(strouhal)  # cells a cycle
    joints = np.concatenate([[0.0], np.cumsum(body.length)]) / cells + _HALF_WIDTH[0]

    def pose(t: float) -> Array:
        y = deflection(joints, t)
        slope = np.arcsin(np.clip(-np.diff(y) * cells / body.length, -1, 1))
        ahead = 0.5 * (size[0] + cells) + advance * _way(t)
        q = np.zeros((E, N))
        q[:, 0], q[:, 1] = ahead, size[1] / 2 + 0.2 + cells * y[0]
        q[:, 2], q[:, 3:] = slope[0], np.diff(slope)
        return q

    at = pose(0.0)
    bodies.place(at)
    force = np.zeros((cycles * steps, E))
    for n in range(cycles * steps):
        after = pose((n + 1) / steps)
        bodies.prescribe(after - at)
        at = after
        bodies.step(HELD)
        force[n] = bodies.motion.force.numpy()[:, :, 0].sum(axis=1)
    mean = force[-_COUNTED * steps :].mean(axis=0)
    thrust = mean / (0.5 * (advance / steps) ** 2 * cells**2)
    thrust = np.where(fluid.stopped.numpy() < 0, thrust, np.nan)
    return Tow(np.array(strouhal), thrust)


def _way(t: float) -> float:
    """Cycles of the full advance after t cycles; the speed grows over the first half."""
    return t - 0.25 if t > 0.5 else t * t


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """24 cells a body length on a CPU, up to 144 on a GPU; ghost cells have a bar."""
    fine = device.startswith("cuda")
    sizes = (16,) if quick else ((48, 96, 144) if fine else (24,))
    tried, cycles = ((0.2, 0.5), 2) if quick else (TRIED, _CYCLES)
    figures, curves = [], []
    for cells, (name, wall) in product(sizes, WALLS.items()):
        found = tow(cells, wall, strouhal=tried, cycles=cycles, device=device, threads=threads)
        label = f"{name}, {cells} cells a body length"
        bar = _BAR if wall.ghosts and not quick else None
        quantity = f"Strouhal number of zero mean force, {label}"
        figures.append(Figure(quantity, found.balance, STROUHAL, bar))
        curves.append(
            Curve(
                f"Mean force, {label}", "Strouhal number", "force over half rho U² L²",
                found.strouhal, found.thrust, np.array([STROUHAL]), np.zeros(1),
            )
        )  # fmt: skip
    return Case(
        name="mackerel",
        title="A mackerel's wave without friction: where thrust balances drag",
        source="Borazjani and Sotiropoulos, J. Exp. Biol. 211 (2008) 1541: about 0.25 without "
        "viscosity",
        setup=f"{LINKS} links with a prescribed midline, towed, {cycles} cycles, periodic, "
        f"{_BOX[0]:g} x {_BOX[1]:g} x {_BOX[2]:g} body lengths, no friction",
        figures=tuple(figures),
        curves=tuple(curves),
    )
