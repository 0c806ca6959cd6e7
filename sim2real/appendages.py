"""What a link carries outside its hull: boxes and cylinders, their drag, added mass and water.

Drag and added mass follow from shape and size by handbook figures (``sim2real.bluff_bodies``). What
rises through the water's surface counts as half of the body and its mirror image: at the speeds of
these robots (a Froude number of 0.2 and less) the surface is nearly flat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, cast

from sim2real import bluff_bodies
from sim2real.bluff_bodies import Coefficient, Sides
from sim2real.structured import Fields, finite_number

KEYS = (
    "name", "shape", "size_m", "at_m", "submerged", "drag_coefficient",
    "lateral_drag_coefficient", "axis", "in_hull",
)  # fmt: skip
AXES = ("along", "across", "up")
LARGEST_M = 10.0
"""Largest size and distance, which finds millimetres."""


@dataclass(frozen=True)
class Wetted:
    """What one appendage does in the water, with its surface at a certain height.

    Attributes:
        place_m: Of the centre: behind the link's front and to the left of its axis.
        length_m: Extent along and across the link.
        area_m2: Drag area (coefficient times area) for motion along and across the link.
        area_sd_m2: Their standard deviations.
        added_mass_m3: Added mass over the density of water, along and across.
        volume_m3: Water that it displaces.
    """

    place_m: tuple[float, float]
    length_m: tuple[float, float]
    area_m2: tuple[float, float]
    area_sd_m2: tuple[float, float]
    added_mass_m3: tuple[float, float]
    volume_m3: float


@dataclass(frozen=True)
class Appendage:
    """A body outside the hull of a link, which moves with it.

    Attributes:
        name: Its name.
        shape: ``box`` or ``cylinder``.
        size_m: Extent along the link, across it and up.
        at_m: Its centre: behind the link's front, to the left of its axis, above its middle.
        submerged: Share of its height under water; None if the robot's draught determines it.
        drag: Drag coefficient for motion along the link, on the area that faces it, with its
            standard deviation; None for that of ``bluff_bodies``.
        lateral_drag: Likewise for motion across the link.
        axis: Direction of a cylinder's axis.
        in_hull: Whether the hull includes it. The hull then displaces its water and resists its
            motion across, and only its drag along the link is added.
    """

    name: str
    shape: Literal["box", "cylinder"]
    size_m: tuple[float, float, float]
    at_m: tuple[float, float, float]
    submerged: float | None = None
    drag: Coefficient | None = None
    lateral_drag: Coefficient | None = None
    axis: Literal["along", "across", "up"] = "along"
    in_hull: bool = False

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
        if self.in_hull:
            return 0.0
        return self.wet_share(surface_m) * bluff_bodies.volume_m3(self.size_m, self._round)

    def wetted(self, surface_m: float) -> Wetted:
        """Its drag, added mass and water with the surface at this height above the middle."""
        share = self.wet_share(surface_m)
        mirrored = 2.0 if 0.0 < share < 1.0 else 1.0
        along, across, up = self.size_m
        sides = Sides((along, across, max(share, 1e-9) * mirrored * up), self._round)
        counted = (share > 0) / mirrored
        areas, sds, masses = [], [], []
        for direction, given in ((0, self.drag), (1, self.lateral_drag)):
            here = counted * (direction == 0 or not self.in_hull)
            value, sd = given or sides.drag_coefficient(direction)
            areas.append(here * value * sides.face_m2(direction))
            sds.append(here * sd * sides.face_m2(direction))
            masses.append(0.0 if self.in_hull else here * sides.added_mass_m3(direction))
        return Wetted(
            place_m=self.at_m[:2],
            length_m=(along, across),
            area_m2=(areas[0], areas[1]),
            area_sd_m2=(sds[0], sds[1]),
            added_mass_m3=(masses[0], masses[1]),
            volume_m3=self.displaced_m3(surface_m),
        )


def area_error(wetted: Sequence[Wetted]) -> float:
    """Relative standard deviation of the sum of drag areas along the links.

    The errors of handbook coefficients count as one common error, and not as independent ones:
    interference between bodies and the turbulence of the water change all of them alike.
    """
    total = sum(one.area_m2[0] for one in wetted)
    return sum(one.area_sd_m2[0] for one in wetted) / total if total > 0 else 0.0


def read_appendage(fields: Fields, length_m: float | None) -> Appendage:
    """Read one ``[[links.appendages]]`` table.

    Args:
        fields: The table.
        length_m: Length of the link, in whose middle an appendage without ``at_m`` is.

    Raises:
        InputError: If a field does not conform to the format.
    """
    fields.refuse_unknown(KEYS)
    shape = _choice(fields, "shape", ("box", "cylinder"))
    axis = _choice(fields, "axis", AXES) if "axis" in fields else "along"
    if "axis" in fields and shape != "cylinder":
        raise fields.error("axis", "no axis of a box")
    size = _lengths(fields, "size_m", 3 if shape == "box" else 2, above_zero=True)
    if shape == "cylinder":
        length, diameter = size
        size = [length if name == axis else diameter for name in AXES]
    at = [(length_m or 0.0) / 2, 0.0, 0.0]
    if "at_m" in fields:
        at = _lengths(fields, "at_m", 3)
    share = fields.optional_number("submerged", low=0)
    if share is not None and share > 1:
        raise fields.error("submerged", "a share from 0 to 1")
    in_hull = fields.content.get("in_hull", False)
    if not isinstance(in_hull, bool):
        raise fields.error("in_hull", "true or false")
    return Appendage(
        name=fields.text("name"),
        shape=cast(Literal["box", "cylinder"], shape),
        size_m=(size[0], size[1], size[2]),
        at_m=(at[0], at[1], at[2]),
        submerged=share,
        drag=_coefficient(fields, "drag_coefficient"),
        lateral_drag=_coefficient(fields, "lateral_drag_coefficient"),
        axis=cast(Literal["along", "across", "up"], axis),
        in_hull=in_hull,
    )


def _choice(fields: Fields, name: str, known: Sequence[str]) -> str:
    value = fields.text(name)
    if value not in known:
        raise fields.error(name, f"one of {', '.join(known)}")
    return value


def _lengths(fields: Fields, name: str, count: int, *, above_zero: bool = False) -> list[float]:
    value = fields.content.get(name)
    numbers = [finite_number(v) for v in value] if isinstance(value, list) else []
    kind = "lengths in m above 0" if above_zero else "distances in m"
    found = [v for v in numbers if v is not None and (v > 0 or not above_zero)]
    if len(numbers) != count or len(found) != count:
        names = "length, diameter" if count == 2 else "along, across, up"
        raise fields.error(name, f"{count} {kind}: {names}")
    if max(abs(v) for v in found) > LARGEST_M:
        raise fields.error(name, f"{count} {kind} within {LARGEST_M:g} m (are they millimetres?)")
    return found


def _coefficient(fields: Fields, name: str) -> Coefficient | None:
    if name not in fields:
        return None
    value = fields.content[name]
    numbers = [finite_number(v) for v in value] if isinstance(value, list) else []
    found = [v for v in numbers if v is not None and v >= 0]
    if len(numbers) != 2 or len(found) != 2:
        raise fields.error(name, "a coefficient and its standard deviation, both at least 0")
    return (found[0], found[1])
