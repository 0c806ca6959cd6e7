"""Video of an evaluation from above: one policy after the other, or several robots side by side.

In the fluid it also shows the vorticity within the simulated box, which moves with the robot.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from rl.world import World
from sim.robot.swimmer import Swimmer
from sim.view.canvas import add_line, blend, draw_ring, draw_robot, grid_lines, places, zoomed
from sim.view.legend import INK, RULE, VORTICITY, Lettering, colours
from sim.view.plane import Plane, front_ends, plane_of
from sim.view.video import FRAMES_PER_S, Video
from sim2real.arrays import Array, Mask, Picture

TARGET = (20, 120, 84)
_MARGIN_M = 0.1
_DRAWN_FOR = 960


def still(world: World, *, width: int = 480) -> Picture:
    """The first robot of a world from above, shape (height, width, 3), 8 bits a channel."""
    live: Any = world.simulator.live()
    return _Camera(world, 0, "", width).picture(float(live.clock.numpy()[0]))


class Film:
    """The part of a video that shows one policy; call it after every step of the world.

    As a context manager it repeats the last picture for one second at the end. Robots by their
    index in the world are shown side by side, with their names; ``width`` is that of each in
    pixels, even. A robot whose episode has ended stays in its last picture.
    """

    def __init__(
        self, video: Video, world: World, names: Mapping[int, str], *, width: int | None = None
    ) -> None:
        # by default three quarters of the video's, as the pool is about as high as it is wide
        wide = width or 2 * round(0.75 * video.width / 2)
        self._video, self._taken = video, 0
        self._cameras = [_Camera(world, robot, name, wide) for robot, name in names.items()]

    def __call__(self, going: Mask) -> None:
        """Extend the trajectories, and add a picture if the next frame is due."""
        for camera in self._cameras:
            camera.follow(going)
        if self._taken < (taken := max(camera.taken for camera in self._cameras)):
            self._taken = taken
            self._add()

    def _add(self) -> None:
        self._video.add(np.concatenate([camera.image for camera in self._cameras], axis=1))

    def __enter__(self) -> Self:
        """Return the film."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:  # noqa: ANN401
        """Repeat the last picture."""
        if kind is None and self._taken:
            for _repeat in range(round(FRAMES_PER_S)):
                self._add()


class _Camera:
    """Follows one robot of a world from above, from its next start on."""

    def __init__(self, world: World, robot: int, name: str, width: int) -> None:
        self._world, self._name, self._robot = world, name, robot
        length, breadth = (side + 2 * _MARGIN_M for side in world.task.domain_m)
        self._pixels = width / length
        self._x, self._y = places(
            (0.0, 0.0), self._pixels, width, 2 * round(breadth * self._pixels / 2)
        )
        self._rules = self._pool()
        self._way = np.zeros_like(self._rules)
        self._last: Array | None = None
        self.taken = 0
        self.image: Picture = np.empty((0, 0, 3), dtype=np.uint8)

    def follow(self, going: Mask) -> None:
        """Extend the trajectory if the robot swam, and take a picture if the next one is due."""
        if not going[self._robot]:
            return
        live: Any = self._world.simulator.live()
        position = self._world.pose[self._robot, :2].cpu().double().numpy()
        if self._last is not None:
            ends = np.stack([self._last, position])
            add_line(self._way, ends, 2.0 * self._x.size / _DRAWN_FOR, self._x, self._y)
        self._last = position
        clock = float(live.clock.numpy()[self._robot])
        if clock + 1e-6 >= self.taken / FRAMES_PER_S:
            self.image = self.picture(clock)
            self.taken += 1

    def picture(self, clock: float) -> Picture:
        """The current picture."""
        world, x, y, e = self._world, self._x, self._y, self._robot
        simulator: Any = world.simulator
        plane: Plane | None = None
        if isinstance(simulator, Swimmer):
            plane = plane_of(simulator, e)
            links = plane.links
            canvas = colours(zoomed(plane, x, y) / VORTICITY)
        else:
            drift = simulator.current[e] * clock
            if hasattr(simulator, "links"):  # of a path that differs from the simulated one
                links = simulator.links(e)
                links[:, :2] += drift
            else:
                links = front_ends(simulator.chain, simulator.motion, drift, e)
            canvas = np.full((y.size, x.size, 3), 255.0)
        blend(canvas, self._rules, RULE)
        waypoint = int(world.waypoint[e])
        for k, target in enumerate(world.targets[e].cpu().double().numpy()):
            draw_ring(
                canvas, target, world.task.arrive_m, x, y, TARGET, 0.5 if k == waypoint else 0.0
            )
        blend(canvas, 0.8 * self._way, INK)
        draw_robot(canvas, simulator.hull, links, x, y)
        lettering = Lettering(np.rint(canvas).astype(np.uint8), _DRAWN_FOR)
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
