"""Conversion of metres to cells, seconds to steps, kilograms to masses of a cell of water."""

from __future__ import annotations

from dataclasses import dataclass

WATER_KG_M3 = 998.0
"""Density of water at 20 degrees C."""
WATER_M2_S = 1.0e-6
"""Kinematic viscosity of water at 20 degrees C."""


@dataclass(frozen=True)
class Units:
    """Sizes of one cell and one step.

    Attributes:
        cell_m: Side of a cell.
        step_s: Duration of a step.
        depth_m: Depth that a cell represents in two dimensions; its side in three.
        density_kg_m3: Density of the fluid.
    """

    cell_m: float
    step_s: float
    depth_m: float
    density_kg_m3: float = WATER_KG_M3

    @property
    def speed_m_s(self) -> float:
        """Speed of one cell per step."""
        return self.cell_m / self.step_s

    @property
    def mass_kg(self) -> float:
        """Mass of one cell of fluid."""
        return self.density_kg_m3 * self.cell_m**2 * self.depth_m

    def viscosity_lu(self, viscosity_m2_s: float) -> float:
        """Kinematic viscosity in cells squared per step."""
        return viscosity_m2_s * self.step_s / self.cell_m**2
