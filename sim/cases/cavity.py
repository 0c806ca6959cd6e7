"""Lid-driven square cavity: velocities on the centre lines in the steady state.

Source of the reference: Ghia, Ghia and Shin, J. Comput. Phys. 48 (1982) 387, tables I and II.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import Fluid
from sim.lattice.cell import MOVING, SOLID
from sim.lattice.velocities import D2Q9
from sim2real.arrays import Array

_LID = 0.1
"""Speed of the lid in cells a step."""
_STEADY = 2e-5
"""Change, in lid speeds while the lid moves its length, below which the flow is steady."""
_LONGEST = 120


@dataclass(frozen=True)
class CentreLines:
    """Steady velocities over the lid's speed, places over the lid's length.

    Attributes:
        place: Cell centres along either line, shape (N,).
        u: Along the lid, on the vertical line, shape (N,).
        v: Upwards, on the horizontal line, shape (N,).
    """

    place: Array
    u: Array
    v: Array


def slide(reynolds: float, cells: int, *, device: str = "cpu", threads: int = 2) -> CentreLines:
    """Simulate until steady; ``cells`` per side is odd, so that one is in the middle."""
    walls = np.zeros((cells + 1, cells + 2), np.uint8)
    walls[0] = walls[:, 0] = SOLID  # cells wrap: the first column is the wall on either side
    walls[1:, -1] = MOVING
    velocity = np.zeros((*walls.shape, 3), np.float32)
    velocity[1:, -1, 0] = _LID
    walls[0, -1] = SOLID
    fluid = Fluid(
        D2Q9,
        walls.shape,
        viscosity=_LID * cells / reynolds,
        walls=walls,
        wall_velocity=velocity,
        device=device,
        threads=threads,
    )
    before = np.zeros((cells, cells, 3), np.float32)
    u = before
    for _ in range(_LONGEST):
        fluid.step(round(cells / _LID))
        u = fluid.moments()[1][0, 1:, 1:-1, 0] / _LID
        change = float(np.abs(u - before).max())
        before = u
        if change < _STEADY:
            break
    middle = cells // 2
    place = (np.arange(cells) + 0.5) / cells
    return CentreLines(place, u[middle, :, 0].astype(float), u[:, middle, 1].astype(float))


@dataclass(frozen=True)
class Published:
    """Ghia's extrema, and the lines of the tables at ``Y`` and ``X``."""

    u_min: float
    v_max: float
    v_min: float
    u: tuple[float, ...]
    v: tuple[float, ...]


# fmt: off
Y = (0.0, 0.0547, 0.0625, 0.0703, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516,
     0.9531, 0.9609, 0.9688, 0.9766, 1.0)
X = (0.0, 0.0625, 0.0703, 0.0781, 0.0938, 0.1563, 0.2266, 0.2344, 0.5, 0.8047, 0.8594, 0.9063,
     0.9453, 0.9531, 0.9609, 0.9688, 1.0)
GHIA = {
    100.0: Published(
        -0.21090, 0.17527, -0.24533,
        (0.0, -0.03717, -0.04192, -0.04775, -0.06434, -0.10150, -0.15662, -0.21090, -0.20581,
         -0.13641, 0.00332, 0.23151, 0.68717, 0.73722, 0.78871, 0.84123, 1.0),
        (0.0, 0.09233, 0.10091, 0.10890, 0.12317, 0.16077, 0.17507, 0.17527, 0.05454, -0.24533,
         -0.22445, -0.16914, -0.10313, -0.08864, -0.07391, -0.05906, 0.0),
    ),
    400.0: Published(
        -0.32726, 0.30203, -0.44993,
        (0.0, -0.08186, -0.09266, -0.10338, -0.14612, -0.24299, -0.32726, -0.17119, -0.11477,
         0.02135, 0.16256, 0.29093, 0.55892, 0.61756, 0.68439, 0.75837, 1.0),
        # at x = 0.9063 the table has -0.23827, known as a misprint
        (0.0, 0.18360, 0.19713, 0.20920, 0.22965, 0.28124, 0.30203, 0.30174, 0.05186, -0.38598,
         -0.44993, np.nan, -0.22847, -0.19254, -0.15663, -0.12146, 0.0),
    ),
    1000.0: Published(
        -0.38289, 0.37095, -0.51550,
        (0.0, -0.18109, -0.20196, -0.22220, -0.29730, -0.38289, -0.27805, -0.10648, -0.06080,
         0.05702, 0.18719, 0.33304, 0.46604, 0.51117, 0.57492, 0.65928, 1.0),
        (0.0, 0.27485, 0.29012, 0.30353, 0.32627, 0.37095, 0.33075, 0.32235, 0.02526, -0.31966,
         -0.42665, -0.51550, -0.39188, -0.33714, -0.27669, -0.21388, 0.0),
    ),
}
# fmt: on


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """Three Reynolds numbers; with ``quick`` only the smallest, in coarser cells."""
    cells = {100.0: 33} if quick else {100.0: 65, 400.0: 97, 1000.0: 97}
    figures, curves = [], []
    for reynolds, n in cells.items():
        ours, published = slide(reynolds, n, device=device, threads=threads), GHIA[reynolds]
        at = f"at Re {reynolds:g}, in lid speeds"
        figures += [
            Figure(f"least u {at}", float(ours.u.min()), published.u_min, 0.01, 1.0),
            Figure(f"largest v {at}", float(ours.v.max()), published.v_max, 0.01, 1.0),
            Figure(f"least v {at}", float(ours.v.min()), published.v_min, 0.01, 1.0),
        ]
        for name, line, where, lines in (
            ("u, vertical line", ours.u, Y, published.u),
            ("v, horizontal line", ours.v, X, published.v),
        ):
            finite = np.isfinite(lines)
            curves.append(
                Curve(
                    f"{name}, Re {reynolds:g}",
                    "place in lid lengths",
                    "velocity in lid speeds",
                    ours.place,
                    line,
                    np.asarray(where)[finite],
                    np.asarray(lines)[finite],
                )
            )
    return Case(
        name="cavity",
        title="Lid-driven cavity",
        source="Ghia, Ghia and Shin, J. Comput. Phys. 48 (1982) 387",
        setup=f"{', '.join(f'{n}' for n in cells.values())} cells a side, lid at {_LID:g} cells a "
        f"step, until steady within {_STEADY:g} a turnover",
        figures=tuple(figures),
        curves=tuple(curves),
    )
