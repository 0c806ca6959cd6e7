"""Colours of a picture and its annotations: key, scale, time, heading, size of the cells."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.arrays import Array, Picture

if TYPE_CHECKING:
    from sim.view.plane import Plane

VORTICITY = 10.0
"""Vorticity in 1/s that has the full colour."""
INK, BODY, RULE = (28, 30, 33), (250, 247, 240), (106, 112, 120)
_STOPS = (
    "#0a2344", "#19528c", "#5698c7", "#b9d6e8", "#ffffff",
    "#f5cab4", "#df8060", "#b8381d", "#5c110b",
)  # fmt: skip
_SHADES = 511
_DRAWN_FOR = 1280
_SCALE_M = 0.2


def colours(share: Array) -> Array:
    """Blue for -1, white for 0, red for 1; a last axis of 3, values 0 to 255."""
    index = np.rint((np.clip(share, -1, 1) + 1) / 2 * (_SHADES - 1)).astype(int)
    return np.asarray(_table()[index])


@cache
def _table() -> Array:
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in _STOPS], dtype=float)
    at = np.linspace(0, len(stops) - 1, _SHADES)
    return np.stack([np.interp(at, range(len(stops)), channel) for channel in stops.T], axis=1)


class Lettering:
    """Text and symbols on a picture; ``unit`` is a pixel of a picture as wide as ``drawn_for``."""

    def __init__(self, image: Picture, drawn_for: int = _DRAWN_FOR) -> None:
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
        length = _SCALE_M * pixels
        self._draw.line(
            (self.right - length, self.low, self.right, self.low), INK, round(4 * self.unit)
        )
        self.write(self.right - length / 2, self.low - 12 * self.unit, f"{_SCALE_M:g} m", "ms")

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


def lettered(image: Picture, plane: Plane, pixels: float) -> Picture:
    """The picture with time, heading, cells, scale and key; ``pixels`` are those of a metre."""
    lettering = Lettering(image)
    cells = f"cells of {100 * plane.cell:.3g} cm"
    lettering.write(lettering.left, lettering.top + 2 * lettering.unit, cells, "lt")
    lettering.write(lettering.left, lettering.low, f"{plane.time:.2f} s", "ls", large=True)
    heading = f"heading {round(np.degrees(plane.links[0, 2]))}°"
    lettering.write(lettering.left + 125 * lettering.unit, lettering.low, heading, "ls", large=True)
    lettering.scale(pixels)
    lettering.key()
    return lettering.image()
