"""Video of an evaluation from above; in the fluid with the vorticity of the simulated box."""

from __future__ import annotations

from typing import Any, Protocol, Self

import numpy as np
import torch

from rl.task import CONTROL_S
from rl.world import World
from sim.robot.shape import hull_of
from sim.robot.swimmer import Swimmer
from sim.view.picture import (
    INK,
    RULE,
    VORTICITY,
    Lettering,
    Plane,
    add_line,
    blend,
    colours,
    draw_ring,
    draw_robot,
    front_ends,
    grid_lines,
    places,
    plane_of,
    zoomed,
)
from sim.view.video import FRAMES_PER_S
from sim2real.arrays import Array, Mask, Picture

TARGET = (20, 120, 84)
MARGIN_M = 0.1
"""Width of the frame around the pool."""
_DRAWN_FOR = 960


def still(world: World) -> Picture:
    """The first robot of a world from above, shape (height, width, 3), 8 bits a channel."""
    return _Camera(world, "", 480).picture()


class Frames(Protocol):
    """Where the frames of a film go: a ``Video``, or a list of pictures."""

    width: int  # in pixels

    def add(self, image: Picture) -> None:
        """Append a frame."""


class Reel(list[Picture]):
    """The frames of a film, in memory."""

    width = 640
    add = list.append


class Film:
    """The part of a video that shows one policy's first robot, ``width`` pixels wide (even)."""

    def __init__(self, video: Frames, world: World, name: str, *, width: int = 0) -> None:
        # by default three quarters of the video's, as the pool is about as high as it is wide
        usual = 2 * round(0.75 * video.width / 2)
        self._camera = _Camera(world, name, width or usual, _DRAWN_FOR if width else usual)
        self._video, self._taken = video, 0
        self._image: Picture | None = None

    def __call__(self, going: Mask) -> None:
        """Extend the trajectory, and add a picture if the next frame is due."""
        if going[0]:
            self._camera.follow()
            if self._camera.clock + 1e-6 >= self._taken / FRAMES_PER_S:
                self._image = self._camera.picture()
                self._video.add(self._image)
                self._taken += 1

    def __enter__(self) -> Self:
        """Return the film."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:  # noqa: ANN401
        """Repeat the last picture."""
        if kind is None and self._image is not None:
            for _repeat in range(round(FRAMES_PER_S)):
                self._video.add(self._image)


class _Camera:
    """Follows the first robot of a world from above, from its next start on."""

    def __init__(self, world: World, name: str, width: int, drawn_for: int = _DRAWN_FOR) -> None:
        self._world, self._name, self._drawn_for = world, name, drawn_for
        length, breadth = (side + 2 * MARGIN_M for side in world.task.domain_m)
        self._pixels = width / length
        height = 2 * round(breadth * self._pixels / 2)
        self._x, self._y = places((0.0, 0.0), self._pixels, width, height)
        self._rules = self._pool()
        self._way = np.zeros_like(self._rules)
        self._last: Array | None = None

    @property
    def clock(self) -> float:
        """Seconds since the robot's start."""
        return CONTROL_S * int(self._world.elapsed[0])

    def follow(self) -> None:
        """Extend the trajectory."""
        position = self._world.pose[0, :2].cpu().double().numpy()
        if self._last is not None:
            ends = np.stack([self._last, position])
            add_line(self._way, ends, 2.0 * self._x.size / _DRAWN_FOR, self._x, self._y)
        self._last = position

    def picture(self) -> Picture:
        """The current picture."""
        world, x, y, clock = self._world, self._x, self._y, self.clock
        simulator = world.simulator
        plane: Plane | None = None
        if isinstance(simulator, Swimmer):
            plane = plane_of(simulator, 0)
            links = plane.links
            canvas = colours(zoomed(plane, x, y) / VORTICITY)
        else:
            q = torch.cat([world.pose[0], world.joint[0]]).cpu().double().numpy()
            links = front_ends(simulator.robot, q)
            canvas = np.full((y.size, x.size, 3), 255.0)
        blend(canvas, self._rules, RULE)
        waypoint = int(world.waypoint[0])
        for k, target in enumerate(world.targets[0].cpu().double().numpy()):
            opacity = 0.5 if k == waypoint else 0.0
            draw_ring(canvas, target, world.task.arrive_m, x, y, TARGET, opacity)
        blend(canvas, 0.8 * self._way, INK)
        draw_robot(canvas, hull_of(simulator.robot), links, x, y)
        lettering = Lettering(np.rint(canvas).astype(np.uint8), self._drawn_for)
        lettering.write(lettering.left, lettering.top, self._name, "lt", large=True)
        caption = f"{clock:.2f} s"
        if world.task.waypoints > 1:
            caption += f"   to target {waypoint + 1} of {world.task.waypoints}"
        lettering.write(lettering.left, lettering.low, caption, "ls", large=True)
        lettering.scale(self._pixels)
        if plane is not None:
            lettering.key()
        return lettering.image()

    def _pool(self) -> Array:
        """Opacity of the grid and the walls of the pool, shape (height, width)."""
        x, y = self._x, self._y
        length, breadth = (side / 2 for side in self._world.task.domain_m)
        inside = (np.abs(x) < length) & (np.abs(y)[:, None] < breadth)
        share = np.where(inside, 0.16 * grid_lines(x, y), 0.16)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * [length, breadth]
        walls = np.zeros_like(share)
        for ends in zip(corners[:-1], corners[1:], strict=True):
            add_line(walls, np.stack(ends), 1.5, x, y)
        return np.asarray(np.maximum(share, walls))
