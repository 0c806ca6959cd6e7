"""The water's law of the twin: its coefficients, and what a robot's shape makes of them.

Where the robot floats, only what is under water counts; the surface is flat, so the water below
moves as if the wetted shape were mirrored in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.lattice.units import WATER_KG_M3
from sim.robot.shape import Hull, afloat, draught

Array = NDArray[np.float64]

POINTS = 3
"""Points of Gauss's rule on a link."""


@dataclass(frozen=True)
class Coefficients:
    """The water's law; pure numbers where no unit is given, 1 where the textbook's value is right.

    The first five are the law as it first was; the defaults of the rest change nothing in it.

    Attributes:
        across: Drag coefficient of a link that moves across its axis, on the wetted height. Water
            that swings to and fro has more than a steady stream: 4 to 8 where it swings by a few
            heights or less (Keulegan and Carpenter, J. Res. Nat. Bur. Stand. 60 (1958) 423).
        along: Drag coefficient of the head's cross-section along it.
        added_mass: Of the mass of the ellipse's circle (Lamb, Hydrodynamics, 1932, art. 71).
        thrust: Of Lighthill's reactive force at the tail's end.
        linear: Drag along the links in N s/m, shared by them according to their lengths.
        slender: Linear drag across the links, of that along them; 2 for a slender body in slow flow
            (Cox, J. Fluid Mech. 44 (1970) 791).
        head: Added mass of the head, of what ``added_mass`` makes of a section in the midst of a
            long body: water can go round the nose.
        axial: Water that goes along as a link moves along its axis, of the water it displaces; that
            of a spheroid is Lamb's k1 (art. 114), the layer of water on the skin adds to it.
        wake: Share of a link's own velocity that the water around it has taken on, in time; all
            drag is that of the link against this water.
        wake_s: Time in s in which it takes it on and loses it again.
        tail: Drag coefficient of the last link across its axis, of ``across``: a fin has edges.
        lag: Way, in wetted heights, that a section goes through the water while its vortices, and
            with them the drag of ``across``, grow.
    """

    across: float = 1.5
    along: float = 0.3
    added_mass: float = 1.0
    thrust: float = 1.0
    linear: float = 0.0
    slender: float = 1.0
    head: float = 1.0
    axial: float = 0.0
    wake: float = 0.0
    wake_s: float = 1.0
    tail: float = 1.0
    lag: float = 0.0

    @classmethod
    def of(cls, body: Mapping[str, Any]) -> Coefficients:
        """Those of a model's body, the fitted ones of ``FITTED`` where it names none.

        A body that names the first five and no other was written when the law had no more; what
        it lacks then changes nothing.
        """
        given = {k: float(v) for k, v in body.get("twin", {}).items()}
        return cls(**given) if given.keys() == FIRST else replace(FITTED, **given)


FIRST = frozenset(("across", "along", "added_mass", "thrust", "linear"))
"""Names of the law as it first was."""
FITTED = Coefficients(
    across=4.006, along=0.4228, added_mass=0.5036, thrust=1.146, linear=0.00343, slender=19.99,
    head=1.501, axial=0.001003, wake=0.1006, wake_s=1.509, tail=0.7669, lag=0.02,
)  # fmt: skip
"""Fitted to the fluid in cells of 1 cm: ``reports/twin``."""


@dataclass(frozen=True)
class Sections:
    """What the water sees of each link of a robot, at Gauss's points on it.

    Attributes:
        place: Where the points are, of the link's length from its front end, shape (POINTS,).
        weight: Their shares of the length, shape (POINTS,).
        added: Water of the ellipse's circle in kg, shape (L, POINTS).
        broad: Half the density times the wetted side in kg/m, shape (L, POINTS).
        frontal: Half the density times the head's wetted cross-section in kg/m.
        displaced: Water displaced by each link in kg, shape (L,).
        height: Wetted heights in m, shape (L, POINTS).
        tip: Water of the circle at the tail's end in kg/m.
        end: How far behind the last joint the tail ends, in m.
        share: Each link's length, of their sum, shape (L,).
    """

    place: Array
    weight: Array
    added: Array
    broad: Array
    frontal: float
    displaced: Array
    height: Array
    tip: float
    end: float
    share: Array


def hull_in_water(hull: Hull, mass_kg: float) -> tuple[Hull, float]:
    """The hull as it lies in the water, and how far the surface is above its middle in m.

    A hull that would sink is scaled to displace its mass, wholly under water: infinity.
    """
    above = draught(hull, mass_kg)
    return (hull, above) if above is not None else (afloat(hull, mass_kg, False)[0], np.inf)


def sections(hull: Hull, above: float) -> Sections:
    """What the water sees of a hull under a surface ``above`` m over its middle.

    Args:
        hull: The links' shape.
        above: Infinite where it is wholly under water.
    """
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    s, weight = (nodes + 1) / 2, weights / 2
    curve = np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)])  # front to back
    high, wide = hull.half_height @ curve, hull.half_width @ curve
    wet = high + np.clip(above, -high, high)
    part = weight * hull.length[:, None]
    end = float(hull.half_height[-1, 2])
    return Sections(
        place=s,
        weight=weight,
        added=WATER_KG_M3 * np.pi / 2 * wet * high * part,
        broad=0.5 * WATER_KG_M3 * wet * part,
        frontal=0.5 * WATER_KG_M3 * float((np.pi / 2 * wide[0] * wet[0]).max()),
        displaced=(WATER_KG_M3 * np.pi / 2 * wet * wide * part).sum(axis=1),
        height=wet,
        tip=float(WATER_KG_M3 * np.pi / 2 * (end + np.clip(above, -end, end)) * end),
        end=float(hull.length[-1] + hull.half_width[-1, 2]),
        share=hull.length / hull.length.sum(),
    )


def law_rows(
    seen: Sections, hull: Hull, com: Array, laws: Sequence[Coefficients], more: Array
) -> dict[str, Array]:
    """Rows of ``sim.twin.kernel.Water`` for E robots.

    Args:
        seen: What the water sees of the hull.
        hull: The links' shape.
        com: Distance of the links' centres of mass from their front ends in m, shape (E, L).
        laws: Coefficients of each robot.
        more: Share of added mass beyond the law's, of each robot, shape (E,).
    """

    def of(name: str) -> Array:
        return np.array([[float(getattr(law, name))] for law in laws])

    E, L = com.shape
    added = of("added_mass") * (1 + more[:, None])
    heads, tails = np.ones((E, L)), np.ones((E, L))
    heads[:, :1], tails[:, -1:] = of("head"), of("tail")
    along = np.zeros((E, L, 2))
    along[:, :, 0] = of("linear") * seen.share
    along[:, :1, 1] = of("along") * seen.frontal
    across = of("slender") * along[:, :, 0]
    behind = seen.end - com[:, -1:]
    return {
        "place": com[:, :, None] - seen.place * hull.length[None, :, None],
        "added": (added * heads)[:, :, None] * seen.added,
        "broad": (of("across") * tails)[:, :, None] * seen.broad,
        "reach": of("lag")[:, :, None] * seen.height,
        "slow": across[:, :, None] * seen.weight,
        "along": along,
        "axial": of("axial") * seen.displaced,
        "tip": np.concatenate([of("thrust") * added * seen.tip, behind], axis=1),
        "wake": np.concatenate([of("wake"), of("wake_s")], axis=1),
    }
