"""Drag and added mass of boxes and cylinders, from handbooks.

Drag coefficients refer to the area that faces the motion, at Reynolds numbers of 1e3 to 1e5, for
which the corners of boxes fix the separation. Sources:

- plates of finite length and square rods parallel to the flow: White, Fluid Mechanics, 7th ed.
  (2011), table 7.3, and Hoerner, Fluid-Dynamic Drag (1965), ch. 3;
- rectangular sections in plane flow, with the maximum where the depth is 0.6 of the height:
  Nakaguchi, Hashimoto and Muto, J. Japan Soc. Aeron. Space Sci. 16 (1968) 1;
- cylinders across and parallel to the flow: White, table 7.3; Hoerner, ch. 3;
- added mass of rectangular sections, plates and cylinders of finite length: DNV-RP-C205 (2010),
  appendix D. The product of the factors of section and length gives 0.69 and 0.39 of the volume for
  square prisms of one and two side lengths; the tables of that appendix say 0.68 and 0.36.

Steady coefficients: for oscillations that are small against the body's size, drag is larger
(Keulegan and Carpenter, J. Res. Nat. Bur. Stand. 60 (1958) 423).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi, sqrt

import numpy as np

Coefficient = tuple[float, float]
"""A coefficient and its standard deviation."""
SCATTER = (0.15, 0.3)
"""Relative standard deviation of coefficients along and across a link: the scatter of published
values, and across it the oscillation."""

_PLATE = ((1.0, 5.0, 10.0, 20.0, 100.0), (1.18, 1.2, 1.3, 1.5, 1.9))
"""Plate that faces the flow, by length over height; 1.98 in plane flow."""
_ROD = (
    (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0),
    (1.18, 1.18, 1.15, 0.97, 0.87, 0.90, 0.93, 0.95, 0.95),
)
"""Square rod parallel to the flow, by depth over side."""
_SECTION = ((0.0, 0.33, 0.62, 1.0, 2.0, 3.0, 5.0), (1.98, 2.3, 2.7, 2.05, 1.5, 1.25, 1.0))
"""Rectangular section in plane flow, by depth over height."""
_AXIAL_CYLINDER = ((0.0, 0.5, 1.0, 2.0, 4.0, 7.0), (1.17, 1.15, 0.91, 0.85, 0.87, 0.99))
"""Cylinder parallel to the flow, by length over diameter."""
_CYLINDER = (
    (1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 40.0, 100.0),
    (0.64, 0.68, 0.72, 0.74, 0.82, 0.91, 0.98, 1.1),
)
"""Cylinder across the flow, by length over diameter."""
_MASS_SECTION = (
    (0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
    (1.0, 1.14, 1.21, 1.36, 1.51, 1.70, 1.98, 2.23),
)
"""Added mass of a rectangular section over that of a plate, by depth over height."""
_MASS_PLATE = (
    (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.25, 8.0, 10.0, 40.0),
    (0.579, 0.642, 0.690, 0.757, 0.801, 0.830, 0.872, 0.897, 0.917, 0.934, 0.947, 1.0),
)
"""Added mass of a plate over that of one in plane flow, by length over height."""
_MASS_CYLINDER = ((0.0, 1.2, 2.5, 5.0, 9.0, 50.0), (0.0, 0.62, 0.78, 0.90, 0.96, 1.0))
"""Added mass of a cylinder across its axis over that in plane flow, by length over diameter."""


def _at(table: tuple[tuple[float, ...], tuple[float, ...]], x: float) -> float:
    return float(np.interp(x, *table))


def volume_m3(size_m: tuple[float, float, float], axis: int | None = None) -> float:
    """Volume of a box, or of a cylinder along one of its three directions."""
    return size_m[0] * size_m[1] * size_m[2] * (1.0 if axis is None else pi / 4)


@dataclass(frozen=True)
class Sides:
    """A box with these extents in m, or the (elliptic) cylinder in it.

    Attributes:
        size_m: Extent along, across, up.
        axis: Direction of a cylinder's axis, 0 to 2; None for a box.
    """

    size_m: tuple[float, float, float]
    axis: int | None = None

    def _facing(self, direction: int) -> tuple[float, float, float]:
        """Longer and shorter side of the face, and depth behind it."""
        across = sorted(s for k, s in enumerate(self.size_m) if k != direction)
        return across[1], across[0], self.size_m[direction]

    def face_m2(self, direction: int) -> float:
        """Area that faces motion in a direction."""
        longer, shorter, _ = self._facing(direction)
        return longer * shorter * (pi / 4 if self.axis == direction else 1.0)

    def drag_coefficient(self, direction: int) -> Coefficient:
        """Drag coefficient for motion in a direction (0 along, 1 across), on ``face_m2``.

        A box is between a rod with a square face of the same area and a section in plane flow: as
        far as a plate of its face is between a square one and one in plane flow.
        """
        longer, shorter, depth = self._facing(direction)
        if self.axis == direction:
            value = _at(_AXIAL_CYLINDER, depth / sqrt(longer * shorter))
        elif self.axis is not None:
            wide = self.size_m[3 - direction - self.axis]
            value = _at(_CYLINDER, self.size_m[self.axis] / wide)
        else:
            plane, square = _SECTION[1][0], _PLATE[1][0]
            share = (_at(_PLATE, longer / shorter) - square) / (plane - square)
            rod, section = _at(_ROD, depth / sqrt(longer * shorter)), _at(_SECTION, depth / shorter)
            value = rod + share * (section - rod)
        return value, SCATTER[min(direction, 1)] * value

    def added_mass_m3(self, direction: int) -> float:
        """Added mass over the density of water for motion in a direction."""
        longer, shorter, depth = self._facing(direction)
        behind = _at(_MASS_SECTION, depth / shorter if shorter > 0 else inf)
        if self.axis is None:
            plate = pi / 4 * shorter**2 * longer * _at(_MASS_PLATE, longer / shorter)
            return behind * plate
        if self.axis == direction:  # a disc: Lamb, Hydrodynamics (1932), art. 102
            return float(behind * (longer * shorter) ** 1.5 / 3)
        long = self.size_m[self.axis]
        wide = self.size_m[3 - direction - self.axis]
        return pi / 4 * wide**2 * long * _at(_MASS_CYLINDER, long / wide)
