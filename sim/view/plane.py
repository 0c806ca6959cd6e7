"""The view from above: the water's vorticity and the robot's outline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim.robot.shape import Hull, between, hull_of
from sim2real.arrays import Array
from sim2real.robot import Robot

if TYPE_CHECKING:
    from sim.robot.swimmer import Swimmer


@dataclass(frozen=True)
class Plane:
    """The horizontal plane through a robot's middle, world frame, SI."""

    vorticity: Array  # in 1/s, anticlockwise above 0, shape (nx, ny)
    corner: tuple[float, float]  # x and y of the first cell's middle
    cell: float  # side of a cell
    centre: tuple[float, float]  # middle of the view: the robot, or the pool with walls
    size: tuple[float, float]  # length and width of the view
    links: Array  # front end and heading of each link, shape (L, 3)
    time: float  # seconds since the start


def plane_of(swimmer: Swimmer, environment: int = 0) -> Plane:
    """The plane of one robot; a box that moves with it is unwrapped, the robot in the middle."""
    bodies, tank, e = swimmer.bodies, swimmer.tank, range(swimmer.n_envs)[environment]
    cell, (nx, ny, nz) = swimmer.units.cell_m, tank.size
    velocity = swimmer.fluid.moments()[1][e, :, :, min(int(bodies.middle), nz - 1)]
    spin = _curl(velocity.astype(np.float64))
    time = float(bodies.motion.clock.numpy()[e])
    q = np.array(bodies.motion.q.numpy()[e])
    drift = swimmer.current[e] * time  # the box moves with the pool's water
    origin = np.array(bodies.grid.origin) + drift
    if tank.sponge:
        middle = bodies.grid.position.numpy()[e].astype(np.float64)
        first = np.rint(middle - (np.array([nx, ny]) - 1) / 2).astype(int)
        spin = np.roll(spin, tuple(-first), axis=(0, 1))
        size, centre = (nx - 2, ny - 2), origin + cell * middle
    else:
        first, size = np.zeros(2), (nx - 1, ny - 1)
        centre = origin + cell * np.array([nx, ny]) / 2
    corner = origin + cell * first
    return Plane(
        vorticity=spin / swimmer.units.step_s,
        corner=(float(corner[0]), float(corner[1])),
        cell=cell,
        centre=(float(centre[0]), float(centre[1])),
        size=(size[0] * cell, size[1] * cell),
        links=front_ends(swimmer.robot, q + np.pad(drift, (0, q.size - 2))),
        time=time,
    )


def front_ends(robot: Robot, q: Array) -> Array:
    """Front end and heading of each link, (L, 3), from the head's pose and angles, (3 + J,)."""
    hull, head = hull_of(robot), robot.links[0]
    com = head.length_m / 2 if head.com_m is None else head.com_m
    heading = q[2] + np.cumsum([0.0, *q[3:]])
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    first = q[:2] + (com - hull.half_width[0, 0]) * forward[0]  # the axis begins behind the nose
    back = np.cumsum(hull.length[:-1, None] * forward[:-1], axis=0)
    return np.column_stack([first - np.vstack([np.zeros(2), back]), heading])


def depth(hull: Hull, links: Array, x: Array, y: Array) -> Array:
    """Signed distance in m of (x, y) from links, front end and heading, (L, 3); negative inside."""
    distance = np.full(np.broadcast(x, y).shape, np.inf)
    for (front_x, front_y, heading), length, half_width in zip(
        links, hull.length, hull.half_width, strict=True
    ):
        dx, dy, c, d = x - front_x, y - front_y, np.cos(heading), np.sin(heading)
        back = np.clip(-(dx * c + dy * d), 0.0, length)
        off = np.hypot(dx + back * c, dy + back * d) - between(half_width, back / length)
        distance = np.minimum(distance, off)
    return distance


def _curl(u: Array) -> Array:
    """Vorticity by central differences in a periodic box; per step."""
    along_x = np.roll(u[..., 1], -1, axis=0) - np.roll(u[..., 1], 1, axis=0)
    along_y = np.roll(u[..., 0], -1, axis=1) - np.roll(u[..., 0], 1, axis=1)
    return np.asarray(along_x - along_y) / 2
