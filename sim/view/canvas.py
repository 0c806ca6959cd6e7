"""Antialiased drawing on an array of colours: water, robot, lines, rings.

A canvas has its rows from the top, shape (height, width, 3), values 0 to 255. ``x`` and ``y`` are
the world coordinates of its columns and rows in m: shapes (width,) and (height,), ``y`` decreasing.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from sim.robot.shape import Hull
from sim.view.legend import BODY, INK
from sim.view.plane import Plane, depth
from sim2real.arrays import Array

GRID_M = 0.25
_STROKE = 0.0026
"""Width of the robot's outline, as a share of the picture's width."""

Colour = tuple[int, int, int]


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
