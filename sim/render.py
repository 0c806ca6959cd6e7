"""A picture of a swimming robot from above: the water's vorticity and the robot's outline."""

from __future__ import annotations

import importlib
import io
import os
from pathlib import Path

import numpy as np

from sim.legend import BODY, INK, RULE, Array, Image, colours, lettered
from sim.plane import Plane, depth, plane_of
from sim.shape import Hull
from sim.swimmer import Swimmer
from sim2real.errors import InputError
from sim2real.output import check_writable, write_whole

VORTICITY = 10.0
"""Vorticity in 1/s that has the full colour."""
_GRID_M = 0.25
_STROKE = 0.0026
"""Width of the outline, as a share of the picture's width."""


def picture(
    swimmer: Swimmer, environment: int = 0, *, width: int = 1280, vorticity: float = VORTICITY
) -> Image:
    """The water in the plane of the robot's middle, and the robot; lines stand in the world.

    Args:
        swimmer: The robots, as they are now.
        environment: Which.
        width: Pixels; the height follows, and is even.
        vorticity: In 1/s, what has the full colour.

    Raises:
        InputError: If Pillow is not installed.
    """
    need("PIL", "Pillow")
    seen = plane_of(swimmer, environment)
    pixels = width / seen.size[0]
    height = 2 * round(seen.size[1] * pixels / 2)
    x = seen.centre[0] + _pixels(width) / pixels
    y = seen.centre[1] - _pixels(height) / pixels
    canvas = colours(_zoomed(seen, x, y) / vorticity)
    _blend(canvas, 0.16 * np.maximum(_lines(x, pixels), _lines(y, pixels)[:, None]), RULE)
    _draw_robot(canvas, swimmer.hull, seen.links, x, y)
    return lettered(np.rint(canvas).astype(np.uint8), seen, pixels, vorticity)


def check_picture(path: str | os.PathLike[str]) -> Path:
    """Make sure, before any work, that a picture can be made and written to ``path``.

    Raises:
        InputError: If it does not end in .png, Pillow is not installed, or the folder can't be
            made or written.
    """
    if Path(path).suffix.lower() != ".png":
        raise InputError(path, "", repr(Path(path).suffix), "a name that ends in .png")
    need("PIL", "Pillow")
    return check_writable(path)


def save_picture(image: Image, path: str | os.PathLike[str]) -> Path:
    """Write a picture as PNG, whole or not at all.

    Raises:
        InputError: If the folder can't be made or written.
    """
    from PIL import Image as Pillow

    stream = io.BytesIO()
    Pillow.fromarray(image).save(stream, format="png", optimize=True)
    return write_whole(path, stream.getvalue())


def need(module: str, name: str) -> None:
    """Make sure that a library of the extra ``sim`` is there.

    Raises:
        InputError: If it is not.
    """
    try:
        importlib.import_module(module)
    except ModuleNotFoundError:
        expected = "pip install 'sim2real[sim]'"
        raise InputError("pictures", "library", f"no {name}", expected) from None


def _pixels(count: int) -> Array:
    """Where pixels are, from the picture's middle."""
    return np.asarray(np.arange(count) + 0.5 - count / 2, dtype=np.float64)


def _zoomed(seen: Plane, x: Array, y: Array) -> Array:
    """The vorticity at the pixels' middles; rows from above."""
    from PIL import Image as Pillow

    half = (x[1] - x[0]) / 2
    left, right = (
        0.5 + (edge - seen.corner[0]) / seen.cell for edge in (x[0] - half, x[-1] + half)
    )
    low, high = (0.5 + (edge - seen.corner[1]) / seen.cell for edge in (y[-1] - half, y[0] + half))
    rows = seen.vorticity.shape[1]
    field = Pillow.fromarray(np.ascontiguousarray(seen.vorticity.T[::-1], dtype=np.float32))
    zoomed = field.resize(
        (x.size, y.size), Pillow.Resampling.BICUBIC, (left, rows - high, right, rows - low)
    )
    return np.asarray(zoomed, dtype=np.float64)


def _lines(along: Array, pixels: float) -> Array:
    """How much of each pixel a line of the world's grid covers."""
    off = np.abs((along / _GRID_M + 0.5) % 1 - 0.5) * _GRID_M * pixels
    return np.asarray(np.clip(1.0 - off, 0, 1))


def _draw_robot(canvas: Array, hull: Hull, links: Array, x: Array, y: Array) -> None:
    """Fill, joints and outline, smooth to a part of a pixel: drawn from the signed distance."""
    back = links[-1, :2] - hull.length[-1] * np.array([np.cos(links[-1, 2]), np.sin(links[-1, 2])])
    ends, margin = np.vstack([links[:, :2], back]), 1.2 * hull.half_width.max()
    columns, rows = (
        np.flatnonzero((along > at.min() - margin) & (along < at.max() + margin))
        for along, at in ((x, ends[:, 0]), (y, ends[:, 1]))
    )
    if not columns.size or not rows.size:
        return
    part = canvas[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    X, Y, pixel = x[columns], y[rows][:, None], x[1] - x[0]
    stroke = _STROKE * x.size
    inside = -depth(hull, links, X, Y) / pixel
    _blend(part, np.clip(inside + 0.5, 0, 1), BODY)
    for joint in links[1:]:
        off = np.hypot(X - joint[0], Y - joint[1]) / pixel
        _blend(part, np.clip(1.5 * stroke - off + 0.5, 0, 1), INK)
    _blend(part, np.clip(stroke / 2 + 0.5 - np.abs(inside), 0, 1), INK)


def _blend(canvas: Array, share: Array, colour: tuple[int, int, int]) -> None:
    touched = share > 0
    canvas[touched] += share[touched, None] * (np.array(colour) - canvas[touched])
