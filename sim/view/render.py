"""A picture of a swimming robot from above: the water's vorticity and the robot's outline."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np

from sim.robot.swimmer import Swimmer
from sim.view.canvas import blend, draw_robot, grid_lines, places, zoomed
from sim.view.legend import RULE, VORTICITY, colours, lettered
from sim.view.plane import plane_of
from sim2real.arrays import Picture
from sim2real.errors import InputError, library
from sim2real.output import check_writable, write_whole


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
    return lettered(np.rint(canvas).astype(np.uint8), plane, pixels)


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
