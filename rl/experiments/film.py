"""Video of an evaluation from above; in the fluid with the vorticity of the simulated box."""

from contextlib import AbstractContextManager
from typing import Any

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
from sim.view.video import FRAMES_PER_S, Video
from sim2real.arrays import Array, Mask, Picture

TARGET = (20, 120, 84)
MARGIN_M = 0.1
"""Width of the frame around the pool."""


def still(world: World) -> Picture:
    """The first robot of a world from above, shape (height, width, 3), 8 bits a channel."""
    return Film(None, world, "", width=480).picture()


class Reel(list[Picture]):
    """The frames of a film, in memory."""

    width = 640
    add = list.append


class Film(AbstractContextManager["Film"]):
    """The part of a video that shows one policy's first robot, from its next start on."""

    def __init__(
        self, video: Video | Reel | None, world: World, name: str, *, width: int = 0
    ) -> None:
        """Follow a robot in pictures ``width`` pixels wide (even)."""
        self._drawn_for = 960
        if video is not None and not width:  # the pool is about as high as it is wide
            width = self._drawn_for = 2 * round(0.75 * video.width / 2)
        self._video, self._world, self._name, self._taken = video, world, name, 0
        self._image: Picture | None = None
        length, breadth = (side + 2 * MARGIN_M for side in world.task.domain_m)
        self._pixels = width / length
        height = 2 * round(breadth * self._pixels / 2)
        self._x, self._y = x, y = places((0.0, 0.0), self._pixels, width, height)
        half = np.array(world.task.domain_m) / 2
        inside = (np.abs(x) < half[0]) & (np.abs(y)[:, None] < half[1])
        walls = np.zeros(inside.shape)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
        for ends in zip(corners[:-1], corners[1:], strict=True):
            add_line(walls, np.stack(ends), 1.5, x, y)
        # opacity of the grid and the walls of the pool, and of the trajectory, (height, width)
        self._rules = np.maximum(np.where(inside, 0.16 * grid_lines(x, y), 0.16), walls)
        self._way = np.zeros_like(self._rules)
        self._last: Array | None = None

    def __call__(self, going: Mask) -> None:
        """Extend the trajectory, and add a picture if the next frame is due."""
        if not going[0]:
            return
        position = self._world.pose[0, :2].cpu().double().numpy()
        if self._last is not None:
            ends = np.stack([self._last, position])
            add_line(self._way, ends, 2.0 * self._x.size / 960, self._x, self._y)
        self._last = position
        clock = CONTROL_S * int(self._world.elapsed[0])
        if self._video is not None and clock + 1e-6 >= self._taken / FRAMES_PER_S:
            self._image = self.picture()
            self._video.add(self._image)
            self._taken += 1

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:  # noqa: ANN401
        """Repeat the last picture."""
        if kind is None and self._video is not None and self._image is not None:
            for _repeat in range(round(FRAMES_PER_S)):
                self._video.add(self._image)

    def picture(self) -> Picture:
        """The current picture."""
        world, x, y = self._world, self._x, self._y
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
        caption = f"{CONTROL_S * int(world.elapsed[0]):.2f} s"
        if world.task.waypoints > 1:
            caption += f"   to target {waypoint + 1} of {world.task.waypoints}"
        lettering.write(lettering.left, lettering.low, caption, "ls", large=True)
        lettering.scale(self._pixels)
        if plane is not None:
            lettering.key()
        return lettering.image()
