"""Wall models: water at a surface takes the body's velocity, or only its component across it.

``NO_SLIP`` (``coupling``) sets the whole velocity: right only where cells resolve the boundary
layer. ``SLIP`` sets only the velocity across the surface, by ghost cells (``ghost_coupling``), and
adds the layer's friction as a stress (Malaspinas and Sagaut, J. Comput. Phys. 275 (2014) 25).
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from sim.lattice.velocities import WATER_M2_S, Units
from sim2real.errors import InputError

LINES = ("none", "laminar", "turbulent")
"""Friction lines: 1.328 / sqrt(Re) is Blasius's, 0.075 / (log10 Re - 2)^2 that of ITTC 1957."""
EDGE = 0.5
"""Distance in cells by which the edges of a sheet are moved inwards. By its added mass a plate with
this edge acts 0.6 to 1 cells too large at each edge (``reports/resolution``)."""
DAMPING = 0.015
"""Increase of the relaxation time of the cells next to ghost cells. With less a spheroid at rest in
a stream has thrust and the flow can break down, with more it has drag in ideal fluid."""
MEMORY = 40.0
"""Steps over which the mass that passes a surface is averaged."""


@wp.struct
class Touch:
    """Parameters of a wall model for the kernels; lengths in cells."""

    line: int  # number of the friction line in ``LINES``
    reynolds: float  # reynolds number of one cell per step over the body's length, in water
    length: float  # the body's length
    edge: float  # ``Wall.edge``


@dataclass(frozen=True)
class Wall:
    """Wall model of bodies."""

    # whether the water slips along the surface, by ghost cells, which exchange nothing along it.
    # Added mass is then right within 2 % for a spheroid of 8 cells of thickness, friction is 0.84
    # to 0.95 of that of its line with 2 to 8 cells, and both drag and friction fall with the length
    # of the time step (``reports/resolution``).
    slip: bool
    # friction line of a smooth surface where it slips, one of ``LINES``; a model's
    # ``surface_friction`` adds to it, link by link
    line: str = "none"
    # distance in cells by which the edges of a sheet are moved inwards where it slips
    edge: float = EDGE

    def __post_init__(self) -> None:
        if self.line not in LINES:
            raise InputError("wall", "line", repr(self.line), f"one of {', '.join(LINES)}")

    def touch(self, length_m: float, units: Units) -> Any:  # noqa: ANN401 - Warp has no stubs
        """The wall model for the kernels, for bodies of this length."""
        touch = Touch()
        touch.line, touch.edge = LINES.index(self.line), self.edge
        touch.reynolds = length_m * units.speed_m_s / WATER_M2_S
        touch.length = length_m / units.cell_m
        return touch


NO_SLIP = Wall(slip=False)
"""Sets the whole velocity: for flows whose boundary layers the cells resolve."""
SLIP = Wall(slip=True, line="turbulent")
"""For robots: the default of ``Swimmer``."""


@wp.func
def layer_ratio(slip: float, away: float, touch: Touch) -> float:
    """Slip velocity outside the boundary layer over that in a cell ``away`` cells from the wall.

    In a turbulent layer the velocity grows with the distance to the power of 1/7, up to the
    thickness 0.37 L Re^(-1/5) at the end of a plate of length L, 5/9 of it on average. Sources:
    Schlichting and Gersten, Boundary-Layer Theory (Springer, 2017), chapter 18; Werner and Wengle,
    Turbulent Shear Flows 8 (Springer, 1993) 155.
    """
    if touch.line != 2:
        return 1.0
    reynolds = wp.max(slip * touch.reynolds, 1.0e3)
    layer = 0.37 * 5.0 / 9.0 * touch.length * wp.pow(reynolds, -0.2)
    return wp.pow(wp.max(layer / wp.max(away, 0.25), 1.0), 1.0 / 7.0)


@wp.func
def friction(slip: float, rough: float, touch: Touch) -> float:
    """Share of the velocity along a wall that friction takes from a cell at the wall in a step.

    The stress is rho / 2 (c + rough) times the square of the slip velocity, c of the friction line.
    Source: Schlichting and Gersten (2017), eq. 2.4 and 18.99 (ITTC 1957).
    """
    reynolds = wp.max(slip * touch.reynolds, 1.0e3)
    c = float(0.0)
    if touch.line == 1:
        c = 1.328 / wp.sqrt(reynolds)
    if touch.line == 2:
        decades = 0.4342944819 * wp.log(reynolds) - 2.0
        c = 0.075 / (decades * decades)
    return 0.5 * wp.max(c + rough, 0.0) * slip
