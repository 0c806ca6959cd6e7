"""What water and cables do to a robot beside the fluid's own forces: drags, water carried, a wall.

Forces on the middles of links, in NumPy, for all robots at once. What has mass is a momentum p of
each link and gives back - dp/dt, within ``SOON_S``: at once it would shake the lightest links.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from surfaces import WATER_KG_M3, Links, Moving
from truth import Truth, values

from sim.robot.shape import Hull, displaced

Array = NDArray[np.float64]

POOL_HALF_M = 1.8
SOON_S = 0.004
GUST_S = 1.2
"""A second swimmer's vortices pass within so many seconds (one sd)."""


class Waters:
    """Drag that grows with the speed or its square, more water carried, a wall, a leak, a wake."""

    def __init__(self, truths: Sequence[Truth], hull: Hull, links: Links, h: float) -> None:
        """Take what is true of E robots of this hull; ``add`` is called every ``h`` s."""
        self._links, self._h = links, h
        self._share = hull.length / hull.length.sum()
        self._slow = values(truths, "linear_drag", "coefficient")[:, None] * self._share
        frontal = np.pi * float((hull.half_width * hull.half_height).max())
        form = values(truths, "form_drag", "coefficient")
        self._form = 0.5 * WATER_KG_M3 * frontal * form
        own = WATER_KG_M3 * displaced(hull, hull.body_length / 60, 0.0, False)[:, 0]
        self._more = values(truths, "added_mass", "ratio")[:, None] * own
        self._spin = self._more * hull.length**2 / 12
        self._wall = values(truths, "wall_effect", "ratio")
        self._tip = WATER_KG_M3 * np.pi * float(hull.half_height[-1, 2]) ** 2
        self._body = hull.body_length
        self._leak = values(truths, "leaking_float", "kg_per_s")
        self._leaks_from = values(truths, "leaking_float", "from_s")
        self._gust = np.stack(
            [values(truths, "second_swimmer", n) for n in ("force_N", "moment_Nm", "beat_hz")]
        )
        self._passes = np.stack(
            [values(truths, "second_swimmer", f"pass{k}_s") for k in (1, 2, 3)], axis=1
        )
        self.reset()

    def reset(self) -> None:
        """Forget how the robots moved."""
        self._carried: Array | None = None
        self._spun: Array | None = None

    def add(self, out: Array, q: Array, v: Array, place: Array, t: float) -> None:
        """Add all to generalised forces.

        Args:
            out: Shape (E, 2 + L).
            q: Coordinates in the water's frame, likewise.
            v: Their rates.
            place: Of the head in the pool, shape (E, 2).
            t: Time in s.
        """
        at = self._links.at(q, v)
        force = -self._slow[..., None] * at.speed
        ahead = at.along[:, 0]
        force[:, 0] -= (self._form * ahead * np.abs(ahead))[:, None] * at.axis[:, 0]
        couple = np.zeros(at.rate.shape)
        self._inertia(force, couple, at, t)
        if self._wall.any():
            self._near_wall(force, at, place)
        if self._gust[0].any():
            size = np.exp(-0.5 * ((t - self._passes) / GUST_S) ** 2).sum(axis=1)
            swing = size * np.sin(2 * np.pi * self._gust[2] * t)
            force[:, 0] += (self._gust[0] * swing)[:, None] * at.normal[:, 0]
            couple[:, 0] += self._gust[1] * size * np.cos(2 * np.pi * self._gust[2] * t)
        at.push(out, force, couple)

    def _inertia(self, force: Array, couple: Array, at: Moving, t: float) -> None:
        carried = (self._more * at.across)[..., None] * at.normal
        leaked = self._leak * np.maximum(t - self._leaks_from, 0.0)
        carried[:, 0] += leaked[:, None] * at.speed[:, 0]
        spun = self._spin * at.rate
        couple -= self._more * at.along * at.across  # Munk's moment: velocity times momentum
        if self._carried is None or self._spun is None:
            self._carried, self._spun = carried, spun
        given, turned = (carried - self._carried) / SOON_S, (spun - self._spun) / SOON_S
        force -= given
        couple -= turned
        self._carried = self._carried + self._h * given
        self._spun = self._spun + self._h * turned

    def _near_wall(self, force: Array, at: Moving, place: Array) -> None:
        gap = POOL_HALF_M - np.abs(place).max(axis=1)
        more = self._wall * (self._body / np.maximum(gap, 0.5 * self._body)) ** 2 * self._tip
        w = at.across[:, -1] - at.rate[:, -1] * 0.5 * self._links.length[-1]
        u = at.along[:, -1]
        force[:, -1] += (0.5 * more * w * w)[:, None] * at.axis[:, -1]
        force[:, -1] -= (more * w * u)[:, None] * at.normal[:, -1]
