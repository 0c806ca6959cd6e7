"""What a link carries outside its hull: boxes and cylinders, their drag, added mass and water.

What rises through the water's surface counts as half of the body and its mirror image: at the
speeds of these robots (a Froude number of 0.2 and less) the surface is nearly flat.

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

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi, sqrt, ulp
from typing import Literal, cast

import numpy as np

from sim2real.structured import Fields

KEYS = (
    "name", "shape", "size_m", "at_m", "submerged", "drag_coefficient",
    "lateral_drag_coefficient", "axis", "in_hull",
)  # fmt: skip
AXES = ("along", "across", "up")
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


@dataclass(frozen=True)
class Sides:
    """A box with these extents in m, or the (elliptic) cylinder in it along ``axis``, 0 to 2."""

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

    @property
    def volume_m3(self) -> float:
        """Volume of the body."""
        along, across, up = self.size_m
        return along * across * up * (1.0 if self.axis is None else pi / 4)

    def drag_coefficient(self, direction: int) -> Coefficient:
        """Drag coefficient on ``face_m2`` for motion in a direction (0 along, 1 across).

        A box is as far between a square rod and plane flow as a plate of its face.
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


@dataclass(frozen=True)
class Wetted:
    """What one appendage does in the water; pairs are along and across its link."""

    place_m: tuple[float, float]  # of the centre: behind the link's front, to the left of its axis
    length_m: tuple[float, float]
    area_m2: tuple[float, float]  # drag area: coefficient times area
    area_sd_m2: tuple[float, float]  # its standard deviation
    added_mass_m3: tuple[float, float]  # over the density of water
    volume_m3: float  # of the water that it displaces


@dataclass(frozen=True)
class Appendage:
    """A body outside the hull of a link, which moves with it."""

    name: str
    shape: Literal["box", "cylinder"]
    size_m: tuple[float, float, float]  # along the link, across it and up
    at_m: tuple[float, float, float]
    """Its centre: behind the link's front, to the left of its axis, above its middle."""
    submerged: float | None = None  # share of its height; None if the draught determines it
    drag: Coefficient | None = None  # along the link, on ``face_m2``; None for that of ``Sides``
    lateral_drag: Coefficient | None = None  # likewise across the link
    axis: Literal["along", "across", "up"] = "along"  # of a cylinder
    in_hull: bool = False
    """Whether the hull includes it. The hull then displaces its water and resists its motion
    across, and only its drag along the link is added."""

    def wet_share(self, surface_m: float) -> float:
        """Share of its height below a surface at this height above the link's middle."""
        if self.submerged is not None:
            return self.submerged
        below = surface_m - self.at_m[2] + self.size_m[2] / 2
        return min(max(below / self.size_m[2], 0.0), 1.0)

    @property
    def _round(self) -> int | None:
        return AXES.index(self.axis) if self.shape == "cylinder" else None

    def displaced_m3(self, surface_m: float) -> float:
        """Volume of water that it displaces in addition to the hull."""
        whole = 0.0 if self.in_hull else Sides(self.size_m, self._round).volume_m3
        return self.wet_share(surface_m) * whole

    def wetted(self, surface_m: float) -> Wetted:
        """Its drag, added mass and water with the surface at this height above the middle."""
        share = self.wet_share(surface_m)
        mirrored = 2.0 if 0.0 < share < 1.0 else 1.0
        along, across, up = self.size_m
        sides = Sides((along, across, max(share, 1e-9) * mirrored * up), self._round)
        counted = (share > 0) / mirrored

        def towards(direction: int, given: Coefficient | None) -> tuple[float, float, float]:
            value, sd = given or sides.drag_coefficient(direction)
            outside = counted * (not self.in_hull)
            face = (outside if direction else counted) * sides.face_m2(direction)
            return value * face, sd * face, outside * sides.added_mass_m3(direction)

        ahead, sideways = towards(0, self.drag), towards(1, self.lateral_drag)
        areas, sds, masses = zip(ahead, sideways, strict=True)
        displaced = self.displaced_m3(surface_m)
        return Wetted(self.at_m[:2], (along, across), areas, sds, masses, displaced)


def area_error(wetted: Sequence[Wetted]) -> float:
    """Relative standard deviation of the sum of drag areas, whose errors are common to all."""
    total = sum(one.area_m2[0] for one in wetted)
    return sum(one.area_sd_m2[0] for one in wetted) / total if total > 0 else 0.0


def read_appendage(fields: Fields, length_m: float | None) -> Appendage:
    """Read one ``[[links.appendages]]`` table; without ``at_m`` it is in the middle of the link."""
    fields.refuse_unknown(KEYS)
    shape, axis = fields.choice("shape", ("box", "cylinder")), fields.choice("axis", AXES, "along")
    if "axis" in fields and shape != "cylinder":
        raise fields.error("axis", "no axis of a box")
    size = _lengths(fields, "size_m", 3 if shape == "box" else 2, above_zero=True)
    if shape == "cylinder":
        length, diameter = size
        size = [length if name == axis else diameter for name in AXES]
    middle = [(length_m or 0.0) / 2, 0.0, 0.0]
    at = _lengths(fields, "at_m", 3) if "at_m" in fields else middle
    share = fields.optional_number("submerged", low=0)
    if share is not None and share > 1:
        raise fields.error("submerged", "a share from 0 to 1")
    return Appendage(
        name=fields.text("name"),
        shape=cast(Literal["box", "cylinder"], shape),
        size_m=(size[0], size[1], size[2]),
        at_m=(at[0], at[1], at[2]),
        submerged=share,
        drag=_coefficient(fields, "drag_coefficient"),
        lateral_drag=_coefficient(fields, "lateral_drag_coefficient"),
        axis=cast(Literal["along", "across", "up"], axis),
        in_hull=fields.flag("in_hull"),
    )


def _lengths(fields: Fields, name: str, count: int, *, above_zero: bool = False) -> list[float]:
    kind = "lengths in m above 0" if above_zero else "distances in m"
    names = "length, diameter" if count == 2 else "along, across, up"
    low = ulp(0.0) if above_zero else -inf
    found = fields.numbers(name, f"{count} {kind}: {names}", count, low=low)
    if max(map(abs, found)) > 10.0:
        raise fields.error(name, f"{count} {kind} within 10 m (are they millimetres?)")
    return found


def _coefficient(fields: Fields, name: str) -> Coefficient | None:
    if name not in fields:
        return None
    expected = "a coefficient and its standard deviation, both at least 0"
    value, sd = fields.numbers(name, expected, 2, low=0.0)
    return value, sd
