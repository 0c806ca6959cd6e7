"""The force law of the twin: its coefficients, and the forces for a robot's shape.

Of a floating robot only the submerged part counts, as if it were mirrored in the flat surface.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim.lattice.velocities import WATER_KG_M3
from sim.robot.shape import Hull, between
from sim2real.arrays import Array
from sim2real.errors import InputError, one_of
from sim2real.robot import Robot
from sim2real.structured import read_json

POINTS = 3
"""Points of Gaussian quadrature on a link."""


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of the force law; the first five are those of the first version."""

    # drag coefficient of a link that moves across its axis, for the wetted height. It is larger in
    # oscillating than in steady flow: 4 to 8 for amplitudes of a few heights or less (Keulegan and
    # Carpenter, J. Res. Nat. Bur. Stand. 60 (1958) 423).
    across: float = 1.5
    along: float = 0.3  # drag coefficient of the head along its axis, for its cross-section
    # added mass relative to that of an ellipse (Lamb, Hydrodynamics, 1932, art. 71).
    added_mass: float = 1.0
    thrust: float = 1.0  # reactive force at the tail's end relative to Lighthill's
    # drag along the links in N s/m, divided among them in proportion to their lengths
    linear: float = 0.0
    # linear drag across the links, relative to that along them; 2 for a slender body in slow flow
    # (Cox, J. Fluid Mech. 44 (1970) 791).
    slender: float = 1.0
    # added mass of the head relative to that of a section far from the ends: water can flow around
    # the nose
    head: float = 1.0
    # added mass of a link along its axis, relative to the displaced water; Lamb's k1 for a spheroid
    # (art. 114), to which the boundary layer adds.
    axial: float = 0.0
    # share of a link's velocity that the water around it approaches; drag depends on the velocity
    # relative to this water
    wake: float = 0.0
    wake_s: float = 1.0  # time constant of the wake in s
    # drag coefficient of the last link across its axis, relative to ``across``: a fin has sharp
    # edges
    tail: float = 1.0
    # distance through the water, in wetted heights, over which the vortices of a section, and so
    # the drag of ``across``, grow
    lag: float = 0.0

    @classmethod
    def of(cls, body: Mapping[str, Any]) -> Coefficients:
        """A body's coefficients; missing ones are ``FITTED``, of a first version the defaults."""
        named = {k: float(v) for k, v in body.get("twin", {}).items()}
        known = [field.name for field in fields(cls)]
        for name in named:
            if name not in known:
                where = f"body.twin.{name}"
                raise InputError("model", where, "an unknown key", one_of(name, known))
        return cls(**named) if named.keys() == FIRST else replace(FITTED, **named)


FIRST = frozenset(("across", "along", "added_mass", "thrust", "linear"))
"""Coefficients of the first version of the law."""
FILE = Path(__file__).with_name("fitted.json")
_FITTED = read_json(FILE)
FITTED_LINKS = _FITTED.pop("links_m")
"""Sizes of the links that it was fitted to, of ``datasets/pool``."""
FITTED = Coefficients(**_FITTED)
"""Fitted to the fluid in cells of 1 cm by ``benchmarks/twin_fit.py``: ``reports/twin``."""


def links_of(robot: Robot) -> dict[str, list[float]]:
    """Sizes of the links in m, which a law is fitted to in the fluid."""
    names = ("length_m", "width_m", "height_m")
    return {name: [float(getattr(link, name)) for link in robot.links] for name in names}


def is_calibrated(body: Mapping[str, Any]) -> bool:
    """Whether recorded swims, and not only the fluid, determine a body's law."""
    stated = {"posterior", "interval"} & body.keys()
    return "twin" in body and bool(stated or "twin_links" not in body)


def warn_unless_fitted(robot: Robot, body: Mapping[str, Any]) -> None:
    """Warn if a body's law was fitted to the fluid for links of other sizes, by more than 5 %."""
    own = links_of(robot)
    links = body.get("twin_links", own if "twin" in body else FITTED_LINKS)
    pairs = [(np.array(links.get(name, ())), np.array(sizes)) for name, sizes in own.items()]
    if not all(a.shape == b.shape and np.allclose(a, b, rtol=0.05) for a, b in pairs):
        warnings.warn(
            f"the twin's force law was not fitted to {robot.name}, whose speeds may be off by tens "
            "of percent; sim2real fit-twin fits it",
            stacklevel=3,
        )


def law_rows(
    hull: Hull, above: float, com: Array, laws: Sequence[Coefficients], more: Array
) -> dict[str, Array]:
    """Rows of ``sim.twin.kernel.Water`` for E robots, at the points of quadrature of each link.

    ``above`` is the height of the surface above the hull's middle in m, ``com`` the distance of the
    links' centres of mass from their front ends in m, (E, L), ``more`` the relative increase of the
    added mass, (E,).
    """
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    s, weight = (nodes + 1) / 2, weights / 2
    high, wide = between(hull.half_height, s), between(hull.half_width, s)  # front to back
    wet = high + np.clip(above, -high, high)  # wetted heights
    part = weight * hull.length[:, None]
    end = float(hull.half_height[-1, 2])
    frontal = 0.5 * WATER_KG_M3 * float((np.pi / 2 * wide[0] * wet[0]).max())
    tip = float(WATER_KG_M3 * np.pi / 2 * (end + np.clip(above, -end, end)) * end)
    tail_arm = float(hull.length[-1] + hull.half_width[-1, 2]) - com[:, -1:]

    def of(name: str) -> Array:
        return np.array([[float(getattr(law, name))] for law in laws])

    E, L = com.shape
    added = of("added_mass") * (1 + more[:, None])
    heads, tails = np.ones((E, L)), np.ones((E, L))
    heads[:, :1], tails[:, -1:] = of("head"), of("tail")
    along = np.zeros((E, L, 2))
    along[:, :, 0] = of("linear") * (hull.length / hull.length.sum())
    along[:, :1, 1] = of("along") * frontal
    across = of("slender") * along[:, :, 0]
    elliptic = WATER_KG_M3 * np.pi / 2 * wet
    return {
        "place": com[:, :, None] - s * hull.length[None, :, None],
        "added": (added * heads)[:, :, None] * (elliptic * high * part),
        "broad": (of("across") * tails)[:, :, None] * (0.5 * WATER_KG_M3 * wet * part),
        "reach": of("lag")[:, :, None] * wet,
        "slow": across[:, :, None] * weight,
        "along": along,
        "axial": of("axial") * (elliptic * wide * part).sum(axis=1),
        "tip": np.concatenate([of("thrust") * added * tip, tail_arm], axis=1),
        "wake": np.concatenate([of("wake"), of("wake_s")], axis=1),
    }
