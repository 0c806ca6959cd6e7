"""Where a robot's links are and how fast; friction along rough materials, drag of appendages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from truth import Truth, values

from sim.robot.shape import Hull
from sim2real.robot import Robot

Array = NDArray[np.float64]

WATER_KG_M3 = 1000.0
STRIPS = 8


@dataclass(frozen=True)
class Moving:
    """E robots' L links at a moment.

    Attributes:
        axis: Unit vectors along the links, towards the nose, shape (E, L, 2).
        speed: Velocity of the links' middles in m/s, shape (E, L, 2).
        rate: Their yaw rates in rad/s, shape (E, L).
        arm: From the head's centre of mass or joint i to the middle of link k that it turns, 0
            where it does not, shape (E, L, L, 2).
    """

    axis: Array
    speed: Array
    rate: Array
    arm: Array

    @property
    def along(self) -> Array:
        """Velocity of the middles along the links, shape (E, L)."""
        return np.asarray(np.vecdot(self.speed, self.axis))

    @property
    def normal(self) -> Array:
        """Unit vectors to the left of the links, shape (E, L, 2)."""
        return np.stack([-self.axis[..., 1], self.axis[..., 0]], axis=-1)

    @property
    def across(self) -> Array:
        """Velocity of the middles to the left of the links, shape (E, L)."""
        return np.asarray(np.vecdot(self.speed, self.normal))

    def push(self, out: Array, force: Array, couple: Array | float = 0.0) -> None:
        """Add forces (E, L, 2) on the middles and couples (E, L) to generalised forces."""
        arm = self.arm
        moment = arm[..., 0] * force[:, :, None, 1] - arm[..., 1] * force[:, :, None, 0]
        moment += np.broadcast_to(couple, force.shape[:2])[:, :, None] * np.tri(arm.shape[1])
        out[:, :2] += force.sum(axis=1)
        out[:, 2:] += moment.sum(axis=1)


class Links:
    """A chain of links by its own geometry."""

    def __init__(self, hull: Hull, com_m: Array | float, side_m: Array | float = 0.0) -> None:
        """Take its shape.

        Args:
            hull: Of the links.
            com_m: From the head's front end back to its centre of mass, where its pose is measured,
                one or one for each robot.
            side_m: From the head's axis to the left, likewise.
        """
        self.length = hull.length
        self._com, self._side = (np.reshape(x, (-1, 1)) for x in (com_m, side_m))
        L = len(hull.length)
        self._bears = np.tri(L)[None, :, :, None]
        """Whether joint i, counted from the head's pose, turns link k: shape (1, L, L, 1)."""

    def at(self, q: Array, v: Array) -> Moving:
        """The links at coordinates q and rates v, both of shape (E, 2 + L)."""
        heading = np.cumsum(q[:, 2:], axis=1)
        axis = np.stack([np.cos(heading), np.sin(heading)], axis=2)
        right = np.stack([axis[:, 0, 1], -axis[:, 0, 0]], axis=1)
        nose = q[:, :2] + self._com * axis[:, 0] + self._side * right
        back = -self.length[:, None] * axis
        front = np.cumsum(np.concatenate([nose[:, None], back[:, :-1]], axis=1), axis=1)
        middle = front - 0.5 * self.length[:, None] * axis
        pivot = np.concatenate([q[:, None, :2], front[:, 1:]], axis=1)
        arm = (middle[:, :, None] - pivot[:, None]) * self._bears
        swept = np.stack([-arm[..., 1], arm[..., 0]], axis=3) * v[:, None, 2:, None]
        return Moving(axis, v[:, None, :2] + swept.sum(axis=2), np.cumsum(v[:, 2:], axis=1), arm)


class Surfaces:
    """Drag along the links, - c / 2 density area u |u|: of materials and of bars across the link.

    The friction of a material acts on the middle of each link; the drag of an appendage on
    ``STRIPS`` parts of its width, each with its own velocity along the link.
    """

    def __init__(self, truths: Sequence[Truth], robot: Robot, hull: Hull, links: Links) -> None:
        """Take what is true of the materials.

        Args:
            truths: One for each of E robots; ``surface_friction.MATERIAL`` has a ``coefficient``.
            robot: Its L links say their material and appendages, which state a drag coefficient.
            hull: Their shape.
            links: Where they are.
        """
        around = np.pi * (hull.half_width + hull.half_height).mean(axis=1)
        rough = [
            values(truths, f"surface_friction.{m.material}", "coefficient") for m in robot.links
        ]
        self._drag = -0.5 * WATER_KG_M3 * around * hull.length * np.stack(rough, axis=1)
        self._links = links
        areas = np.array([truth.areas for truth in truths])
        self._bars = []
        for k, link in enumerate(robot.links):
            for bar in link.appendages:
                if bar.drag is None:
                    raise ValueError(f"no drag coefficient of {bar.name}")
                area = bar.drag[0] * bar.size_m[1] * bar.size_m[2]
                left = bar.at_m[1] + bar.size_m[1] * ((np.arange(STRIPS) + 0.5) / STRIPS - 0.5)
                self._bars.append((k, -0.5 * WATER_KG_M3 * area / STRIPS * areas, left))

    def add(self, out: Array, q: Array, v: Array) -> None:
        """Add it to generalised forces at coordinates q and rates v, all of shape (E, 2 + L)."""
        if not self._drag.any() and not self._bars:
            return
        at = self._links.at(q, v)
        along = at.along
        force, couple = self._drag * along * np.abs(along), np.zeros(along.shape)
        for k, drag, left in self._bars:
            speed = along[:, k, None] - at.rate[:, k, None] * left
            strip = drag[:, None] * speed * np.abs(speed)
            force[:, k] += strip.sum(axis=1)
            couple[:, k] -= strip @ left
        at.push(out, force[..., None] * at.axis, couple)
