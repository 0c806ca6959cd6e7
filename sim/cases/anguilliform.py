"""Self-propelled eel with Carling's midline: its swimming speed.

Source: Kern and Koumoutsakos, J. Exp. Biol. 209 (2006) 4841, two-dimensional case: 0.54 body
lengths a cycle at a viscosity of 1.4e-4 body lengths squared a cycle. That is Re 5609 with the
largest speed of the tail's tip, as in Bhalla et al., J. Comput. Phys. 250 (2013) 446. The midline:
Carling, Williams, Bowtell, J. Exp. Biol. 201 (1998) 3143.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.cases.swimming import SwimPath, swim
from sim2real.arrays import Array

SPEED = 0.54
VISCOSITY = 1.4e-4
LINKS = 14
_NOSE, _TIP, _TAIL = 0.04, 0.01, 0.95
_STEPS = 15
"""Steps of a cycle for each cell of a body length: the tip moves 0.06 cells a step."""
_BOX = (6.0, 3.0)


@dataclass(frozen=True)
class Eel:
    """Carling's midline, divided into links of equal length."""

    heading: float = 0.0

    def joints(self, t: float) -> Array:
        """Joint angles in rad at t cycles; the wave grows over the first."""
        s = np.linspace(_NOSE, 1 - _TIP, LINKS + 1)
        y = 0.125 * (s + 0.03125) / 1.03125 * np.sin(2 * np.pi * (s - t))
        growth = np.sin(np.pi / 2 * min(1.0, t))
        return np.asarray(np.diff(np.arcsin(-growth * np.diff(y) / (s[1] - s[0]))))


def radii() -> Array:
    """Half-widths at the joints in body lengths: a round nose, tapering to a blunt tip."""
    s = np.linspace(_NOSE, 1 - _TIP, LINKS + 1)
    taper = _NOSE - (_NOSE - _TIP) * (s - _NOSE) / (_TAIL - _NOSE)
    return np.asarray(np.maximum(taper, _TIP))


def eel(cells: int, cycles: int, *, device: str = "cpu", threads: int = 2) -> SwimPath:
    """Simulate the eel with a number of cells per body length."""
    return swim(
        [Eel()],
        cells,
        radii=radii(),
        reynolds=1 / VISCOSITY,
        box=_BOX,
        steps=_STEPS * cells,
        cycles=cycles,
        device=device,
        threads=threads,
    )


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """Up to 96 cells per body length on a CPU, 384 on a GPU.

    The boundary layer of this eel is one cell thick at 96 cells, where the speed still increases
    with resolution; only the result on a GPU has a bar.
    """
    fine = device.startswith("cuda")
    sizes = (32,) if quick else ((96, 192, 384) if fine else (48, 96))
    cycles = 4 if quick else 8
    figures, curves = [], []
    for cells in sizes:
        eels = eel(cells, cycles, device=device, threads=threads)
        bar = 0.1 if fine and cells == sizes[-1] else None
        name = f"speed at {cells} cells a body length, body lengths a cycle"
        figures.append(Figure(name, float(eels.speed()[0]), SPEED, bar))
        each = np.linalg.norm(np.diff(eels.path[:, 0, :2], axis=0), axis=1)
        curves.append(
            Curve(
                f"Speed at {cells} cells", "cycle", "body lengths a cycle", eels.cycles[1:], each,
                eels.cycles[[1, -1]], np.full(2, SPEED),
            )
        )  # fmt: skip
    return Case(
        name="anguilliform",
        title="Self-propelled anguilliform swimmer, Re 5609",
        source="Kern and Koumoutsakos, J. Exp. Biol. 209 (2006) 4841, two-dimensional case",
        setup=f"{LINKS} links with prescribed joints on Carling's midline, density ratio 1, "
        f"{_STEPS} steps a cycle for each cell, periodic, {_BOX[0]:g} x {_BOX[1]:g} body lengths",
        figures=tuple(figures),
        curves=tuple(curves),
    )
