"""The view from above: the water's vorticity and the robot's outline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.robot.chain import Chain, Motion
from sim.robot.shape import Hull, between
from sim2real.arrays import Array

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
        links=front_ends(bodies.chain, bodies.motion, drift, e),
        time=time,
    )


def front_ends(chain: Chain, motion: Motion, drift: Array, environment: int) -> Array:
    """Front end and heading of each link, shape (L, 3), in water that moved by ``drift`` (2,)."""
    e = environment
    arrays: Any = motion.link, chain.com, chain.side
    pose, com, side = (np.array(array.numpy()[e], dtype=np.float64) for array in arrays)
    forward = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    lateral = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    pose[:, :2] += drift + com[:, None] * forward - side[:, None] * lateral
    return pose


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
