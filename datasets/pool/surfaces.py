"""Friction of the water along links of rough materials, by the chain's own geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from truth import Truth, values

from sim.robot.shape import Hull
from sim2real.robot import Robot

Array = NDArray[np.float64]

WATER_KG_M3 = 1000.0


class Surfaces:
    """Drag along the middle of each link, - c / 2 density area u |u|, c by material."""

    def __init__(self, truths: Sequence[Truth], robot: Robot, hull: Hull, com_m: float) -> None:
        """Take what is true of the materials.

        Args:
            truths: One for each of E robots; ``surface_friction.MATERIAL`` has a ``coefficient``.
            robot: Its L links say their material.
            hull: Their shape.
            com_m: From the head's front end to its centre of mass, where its pose is measured.
        """
        around = np.pi * (hull.half_width + hull.half_height).mean(axis=1)
        rough = [
            values(truths, f"surface_friction.{m.material}", "coefficient") for m in robot.links
        ]
        self._drag = -0.5 * WATER_KG_M3 * around * hull.length * np.stack(rough, axis=1)
        self._length, self._com = hull.length, com_m
        L = len(robot.links)
        self._bears = np.tri(L)[None, :, :, None]
        """Whether joint i, counted from the head's pose, turns link k: shape (1, L, L, 1)."""

    def add(self, out: Array, q: Array, v: Array) -> None:
        """Add it to generalised forces at coordinates q and rates v, all of shape (E, 2 + L)."""
        if not self._drag.any():
            return
        heading = np.cumsum(q[:, 2:], axis=1)
        axis = np.stack([np.cos(heading), np.sin(heading)], axis=2)
        nose = q[:, :2] + self._com * axis[:, 0]
        back = -self._length[:, None] * axis
        front = np.cumsum(np.concatenate([nose[:, None], back[:, :-1]], axis=1), axis=1)
        middle = front - 0.5 * self._length[:, None] * axis
        pivot = np.concatenate([q[:, None, :2], front[:, 1:]], axis=1)
        arm = (middle[:, :, None] - pivot[:, None]) * self._bears
        swept = np.stack([-arm[..., 1], arm[..., 0]], axis=3) * v[:, None, 2:, None]
        speed = v[:, None, :2] + swept.sum(axis=2)
        along = np.vecdot(speed, axis)
        force = (self._drag * along * np.abs(along))[..., None] * axis
        moment = arm[..., 0] * force[:, :, None, 1] - arm[..., 1] * force[:, :, None, 0]
        for k in range(len(self._length)):
            out[:, :2] += force[:, k]
            out[:, 2:] += moment[:, k]
