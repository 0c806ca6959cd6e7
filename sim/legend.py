"""Colours of a picture, and what tells their meaning: key, scale, time, heading, cells."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sim.plane import Plane

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
"""Rows from above, shape (height, width, 3)."""

INK, BODY, RULE = (28, 30, 33), (250, 247, 240), (106, 112, 120)
_STOPS = (
    "#0a2344", "#19528c", "#5698c7", "#b9d6e8", "#ffffff",
    "#f5cab4", "#df8060", "#b8381d", "#5c110b",
)  # fmt: skip
_SHADES = 511
_DRAWN_FOR = 1280
_SCALE_M = 0.2


def colours(share: Array) -> Array:
    """Blue for -1, white for 0, red for 1; one more axis of 3, from 0 to 255."""
    index = np.rint((np.clip(share, -1, 1) + 1) / 2 * (_SHADES - 1)).astype(int)
    return np.asarray(_table()[index])


@cache
def _table() -> Array:
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _STOPS], dtype=float)
    at = np.linspace(0, len(stops) - 1, _SHADES)
    return np.stack([np.interp(at, range(len(stops)), channel) for channel in stops.T], axis=1)


def lettered(image: Image, seen: Plane, pixels: float, vorticity: float) -> Image:
    """The picture with its time, the head's heading, the cells, a scale and a key to the colours.

    Args:
        image: The picture.
        seen: What it shows.
        pixels: Of a metre.
        vorticity: In 1/s, what has the full colour.
    """
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    page = Pillow.fromarray(image)
    draw = ImageDraw.Draw(page)
    unit = page.width / _DRAWN_FOR
    font, small = (ImageFont.load_default(size * unit) for size in (30, 22))
    left, right, low = 32 * unit, page.width - 32 * unit, page.height - 32 * unit
    top = 34 * unit

    def write(
        x: float,
        y: float,
        text: str,
        anchor: str,
        with_font: ImageFont.FreeTypeFont | ImageFont.ImageFont = small,
    ) -> None:
        draw.text(
            (x, y), text, INK, with_font, anchor, stroke_width=2.5 * unit, stroke_fill="white"
        )

    write(left, top, f"cells of {100 * seen.cell:.3g} cm", "lt")
    write(left, low, f"{seen.time:.2f} s", "ls", font)
    write(left + 125 * unit, low, f"heading {round(np.degrees(seen.links[0, 2]))}°", "ls", font)
    long = _SCALE_M * pixels
    draw.line((right - long, low, right, low), INK, round(4 * unit))
    write(right - long / 2, low - 12 * unit, f"{_SCALE_M:g} m", "ms")
    wide, high = round(220 * unit), round(12 * unit)
    shades = np.tile(colours(np.linspace(-1, 1, wide)), (high, 1, 1)).astype(np.uint8)
    corner = round(right) - wide, round(top)
    page.paste(Pillow.fromarray(shades), corner)
    draw.rectangle((*corner, corner[0] + wide, corner[1] + high), None, RULE)
    under = corner[1] + high + 8 * unit
    write(corner[0], under, f"-{vorticity:g}", "ma")
    write(corner[0] + wide / 2, under, "vorticity, 1/s", "ma")
    write(corner[0] + wide, under, f"{vorticity:g}", "ma")
    return np.asarray(page)
