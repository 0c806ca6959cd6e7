"""A picture of a swimming robot from above: the water's vorticity, outline, key and scale.

A canvas has its rows from the top, shape (height, width, 3), values 0 to 255. ``x`` and ``y`` are
the world coordinates of its columns and rows in m: shapes (width,) and (height,), ``y`` decreasing.
"""

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from sim.robot.shape import Hull, between, hull_of
from sim.robot.swimmer import Swimmer
from sim2real.arrays import Array, Picture
from sim2real.errors import InputError, library
from sim2real.output import check_writable, write_whole
from sim2real.robot import Robot

VORTICITY = 10.0
"""Vorticity in 1/s that has the full colour."""
INK, BODY, RULE = (28, 30, 33), (250, 247, 240), (106, 112, 120)
GRID_M = 0.25
_STROKE = 0.0026
"""Width of the robot's outline, as a share of the picture's width."""
_STOPS = (
    "#0a2344", "#19528c", "#5698c7", "#b9d6e8", "#ffffff",
    "#f5cab4", "#df8060", "#b8381d", "#5c110b",
)  # fmt: skip

Colour = tuple[int, int, int]


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
    u, v = np.moveaxis(velocity.astype(np.float64)[..., :2], 2, 0)
    # central differences in a periodic box
    spin = (np.roll(v, -1, axis=0) - np.roll(v, 1, axis=0)) / 2
    spin -= (np.roll(u, -1, axis=1) - np.roll(u, 1, axis=1)) / 2
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


def places(
    centre: tuple[float, float], pixels: float, width: int, height: int
) -> tuple[Array, Array]:
    """``x`` and ``y`` of a canvas about ``centre``, with ``pixels`` per metre."""
    columns, rows = (np.arange(n, dtype=np.float64) + 0.5 - n / 2 for n in (width, height))
    return np.asarray(centre[0] + columns / pixels), np.asarray(centre[1] - rows / pixels)


def blend(canvas: Array, share: Array, colour: Colour) -> None:
    """Blend a colour into a canvas by ``share``, shape (height, width)."""
    touched = share > 0
    canvas[touched] += share[touched, None] * (np.array(colour) - canvas[touched])


def zoomed(plane: Plane, x: Array, y: Array) -> Array:
    """The vorticity in 1/s at the canvas's pixels by cubic splines, 0 outside the box."""
    weights = []
    for along, corner, count in zip((x, y), plane.corner, plane.vorticity.shape, strict=True):
        at = (along - corner) / plane.cell
        cells = make_interp_spline(np.arange(count), np.eye(count))
        inside = (at > -0.5) & (at < count - 0.5)
        weights.append(inside[:, None] * cells(np.clip(at, 0, count - 1)))
    return np.asarray(weights[1] @ plane.vorticity.T @ weights[0].T)


def grid_lines(x: Array, y: Array) -> Array:
    """Share of each pixel that lines of the world grid cover, shape (height, width)."""
    across, down = (
        np.abs((along / GRID_M + 0.5) % 1 - 0.5) * GRID_M / (x[1] - x[0]) for along in (x, y)
    )
    return np.asarray(np.clip(1.0 - np.minimum(across, down[:, None]), 0, 1))


def add_line(share: Array, ends: Array, width: float, x: Array, y: Array) -> None:
    """Add a line between ``ends`` (2, 2) in m, ``width`` pixels wide, to shares (height, width)."""
    pixel = x[1] - x[0]
    window = _window(ends, (width + 2) * pixel, x, y)
    X, Y = x[window[1]], y[window[0]][:, None]
    start, way = ends[0], ends[1] - ends[0]
    long = max(float(way @ way), 1e-18)
    along = np.clip(((X - start[0]) * way[0] + (Y - start[1]) * way[1]) / long, 0, 1)
    off = np.hypot(X - start[0] - along * way[0], Y - start[1] - along * way[1]) / pixel
    part = share[window]
    np.maximum(part, np.clip(width / 2 + 0.5 - off, 0, 1), out=part)


def draw_ring(
    canvas: Array, centre: Array, radius: float, x: Array, y: Array, colour: Colour, fill: float
) -> None:
    """A circle of ``radius`` m about ``centre``, filled with a share ``fill`` of its colour."""
    pixel = x[1] - x[0]
    window = _window(centre[None], 1.5 * radius + 3 * pixel, x, y)
    off = (np.hypot(x[window[1]] - centre[0], y[window[0]][:, None] - centre[1]) - radius) / pixel
    stroke = _STROKE * x.size
    inside = fill * np.clip(0.5 - off, 0, 1)
    blend(canvas[window], np.maximum(inside, np.clip(stroke / 2 + 0.5 - np.abs(off), 0, 1)), colour)


def draw_robot(canvas: Array, hull: Hull, links: Array, x: Array, y: Array) -> None:
    """Draw body, joints and outline of links by their front ends and headings, shape (L, 3)."""
    back = links[-1, :2] - hull.length[-1] * np.array([np.cos(links[-1, 2]), np.sin(links[-1, 2])])
    window = _window(np.vstack([links[:, :2], back]), 1.2 * hull.half_width.max(), x, y)
    part = canvas[window]
    if not part.size:
        return
    X, Y, pixel = x[window[1]], y[window[0]][:, None], x[1] - x[0]
    stroke = _STROKE * x.size
    inside = -depth(hull, links, X, Y) / pixel
    blend(part, np.clip(inside + 0.5, 0, 1), BODY)
    for joint in links[1:]:
        off = np.hypot(X - joint[0], Y - joint[1]) / pixel
        blend(part, np.clip(1.5 * stroke - off + 0.5, 0, 1), INK)
    blend(part, np.clip(stroke / 2 + 0.5 - np.abs(inside), 0, 1), INK)


def _window(points: Array, margin: float, x: Array, y: Array) -> tuple[slice, slice]:
    """Rows and columns within ``margin`` of the points, shape (N, 2)."""
    slices = []
    for along, at in ((y, points[:, 1]), (x, points[:, 0])):
        near = np.flatnonzero((along > at.min() - margin) & (along < at.max() + margin))
        slices.append(slice(near[0], near[-1] + 1) if near.size else slice(0, 0))
    return slices[0], slices[1]


def colours(share: Array) -> Array:
    """Blue for -1, white for 0, red for 1; a last axis of 3, values 0 to 255."""
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _STOPS], dtype=float)
    at = np.linspace(0, len(stops) - 1, 511)
    table = np.stack([np.interp(at, range(len(stops)), channel) for channel in stops.T], axis=1)
    index = np.rint((np.clip(share, -1, 1) + 1) / 2 * 510).astype(int)
    return np.asarray(table[index])


class Lettering:
    """Text and symbols on a picture; ``unit`` is a pixel of a picture as wide as ``drawn_for``."""

    def __init__(self, image: Picture, drawn_for: int = 1280) -> None:
        from PIL import Image as Pillow
        from PIL import ImageDraw, ImageFont

        self._page = Pillow.fromarray(image)
        self._draw: Any = ImageDraw.Draw(self._page)
        self.unit = self._page.width / drawn_for
        self._large, self._small = (ImageFont.load_default(n * self.unit) for n in (30, 22))
        margin = 32 * self.unit
        self.left, self.right = margin, self._page.width - margin
        self.top, self.low = margin, self._page.height - margin

    def write(self, x: float, y: float, text: str, anchor: str, *, large: bool = False) -> None:
        """Write text at a position in pixels; ``anchor`` as in Pillow: ``lt`` is left and top."""
        self._draw.text(
            (x, y), text, INK, self._large if large else self._small, anchor,
            stroke_width=2.5 * self.unit, stroke_fill="white",
        )  # fmt: skip

    def scale(self, pixels: float) -> None:
        """Draw a scale bar at the lower right; ``pixels`` are those of a metre."""
        left = self.right - 0.2 * pixels
        self._draw.line((left, self.low, self.right, self.low), INK, round(4 * self.unit))
        self.write(self.right - 0.2 * pixels / 2, self.low - 12 * self.unit, "0.2 m", "ms")

    def key(self) -> None:
        """Draw a colour bar of the vorticity at the upper right."""
        from PIL import Image as Pillow

        unit = self.unit
        width, height = round(220 * unit), round(12 * unit)
        shades = np.tile(colours(np.linspace(-1, 1, width)), (height, 1, 1)).astype(np.uint8)
        corner = round(self.right) - width, round(self.top + 2 * unit)
        self._page.paste(Pillow.fromarray(shades), corner)
        self._draw.rectangle((*corner, corner[0] + width, corner[1] + height), None, RULE)
        under = corner[1] + height + 8 * unit
        self.write(corner[0], under, f"-{VORTICITY:g}", "ma")
        self.write(corner[0] + width / 2, under, "vorticity, 1/s", "ma")
        self.write(corner[0] + width, under, f"{VORTICITY:g}", "ma")

    def image(self) -> Picture:
        """The annotated picture."""
        return np.asarray(self._page)


def picture(swimmer: Swimmer, *, width: int = 1280) -> Picture:
    """The water in the plane of the first robot's middle, and the robot, ``width`` pixels wide."""
    library("PIL", "pictures")
    plane = plane_of(swimmer)
    pixels = width / plane.size[0]
    height = 2 * round(plane.size[1] * pixels / 2)
    x, y = places(plane.centre, pixels, width, height)
    canvas = colours(zoomed(plane, x, y) / VORTICITY)
    blend(canvas, 0.16 * grid_lines(x, y), RULE)
    draw_robot(canvas, swimmer.hull, plane.links, x, y)
    lettering = Lettering(np.rint(canvas).astype(np.uint8))
    left, low, unit = lettering.left, lettering.low, lettering.unit
    lettering.write(left, lettering.top + 2 * unit, f"cells of {100 * plane.cell:.3g} cm", "lt")
    lettering.write(left, low, f"{plane.time:.2f} s", "ls", large=True)
    heading = f"heading {round(np.degrees(plane.links[0, 2]))}°"
    lettering.write(left + 125 * unit, low, heading, "ls", large=True)
    lettering.scale(pixels)
    lettering.key()
    return lettering.image()


def check_picture(path: str | os.PathLike[str]) -> Path:
    """Check before the simulation that a picture can be made and written to ``path``."""
    if Path(path).suffix.lower() != ".png":
        raise InputError(path, "", repr(Path(path).suffix), "a name that ends in .png")
    library("PIL", "pictures")
    return check_writable(path)


def save_picture(image: Picture, path: str | os.PathLike[str]) -> Path:
    """Write a picture as PNG, whole or not at all."""
    from PIL import Image as Pillow

    stream = io.BytesIO()
    Pillow.fromarray(image).save(stream, format="png", optimize=True)
    return write_whole(path, stream.getvalue())
