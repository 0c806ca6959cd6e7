"""Where in a frame a print may be: a matched filter that needs no corners.

OpenCV's own detector wants a marker of 20 pixels or so. This one knows the print, its size and its
level, and finds it at 8, comparing every spot with the print turned by every angle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.hardware.plane import Plane
from sim2real.hardware.registration import Print, darkness

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

YAWS = 24
SIDE_PX = 12.0  # a print larger than this is looked for in a smaller picture
SPOTS = 12
BLUR_PX = 0.55
QUIET_CELLS = 0.6  # of the white margin that belong to a pattern


@dataclass(frozen=True)
class Bank:
    """A print as it looks at every angle.

    Attributes:
        patterns: Grey levels from 0 to 1, shape (K, side, side).
        masks: 1 where the print and its white margin are, likewise.
        yaws: Their angles in the world, rad, shape (K,).
        shrink: How many pixels of the frame make one of the patterns'.
    """

    patterns: NDArray[np.float32]
    masks: NDArray[np.float32]
    yaws: Array
    shrink: float


def bank(plane: Plane, marker: Print) -> Bank:
    """The patterns as seen in the middle of the frame."""
    middle = (np.array(plane.lens.size_px) - 1) // 2
    here = plane.world(middle[None], marker.height_m)[0]
    side = marker.side_m * plane.pixels_per_m(here, marker.height_m)
    shrink = max(1.0, side / SIDE_PX)
    cells = marker.ink.shape[0]
    half = int(np.ceil(side / shrink * (0.5 + QUIET_CELLS / cells) * np.sqrt(2)))
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    spots = plane.world(middle + shrink * np.column_stack([u.ravel(), v.ravel()]), marker.height_m)
    east, north = ((spots - here) / marker.cell_m).T
    blur = BLUR_PX / SIDE_PX * cells * max(1.0, SIDE_PX / side)
    yaws = np.arange(YAWS) * 2 * np.pi / YAWS
    patterns, masks = np.empty((2, YAWS, 2 * half + 1, 2 * half + 1), dtype=np.float32)
    for k, yaw in enumerate(yaws):
        c, s = np.cos(yaw), np.sin(yaw)
        ahead, left = c * east + s * north, c * north - s * east
        dark, _ = darkness(marker.ink, cells / 2 - ahead, cells / 2 - left, blur)
        patterns[k] = (1 - dark).reshape(u.shape)
        inside = np.maximum(np.abs(ahead), np.abs(left)) < cells / 2 + QUIET_CELLS
        masks[k] = inside.reshape(u.shape)
    return Bank(patterns, masks, yaws, shrink)


def search(
    frame: Picture, plane: Plane, marker: Print, patterns: Bank, window: tuple[int, int, int, int]
) -> Array:
    """Poses worth a closer look, the likeliest first.

    Args:
        frame: Grey levels, shape (V, U).
        plane: The camera.
        marker: What to look for.
        patterns: How it looks.
        window: First column and row, last column and row (exclusive) to look in.

    Returns:
        Poses, shape (N, 3); N may be 0.
    """
    import cv2

    size = patterns.patterns.shape[1]
    left, top, right, bottom = window
    part: NDArray[Any] = frame[top:bottom, left:right]
    if patterns.shrink > 1:
        wanted = np.maximum(np.round(np.array(part.shape[::-1]) / patterns.shrink), 1).astype(int)
        part = cv2.resize(part, (int(wanted[0]), int(wanted[1])), interpolation=cv2.INTER_AREA)
    if min(part.shape) < size:
        return np.empty((0, 3))
    grey = part.astype(np.float32)
    likeness = np.stack(
        [
            cv2.matchTemplate(grey, pattern, cv2.TM_CCOEFF_NORMED, mask=mask)
            for pattern, mask in zip(patterns.patterns, patterns.masks, strict=True)
        ]
    )
    likeness = np.where(np.isfinite(likeness), likeness, 0.0)
    turned = likeness.argmax(axis=0)
    rows, columns = _peaks(likeness.max(axis=0))
    centres = np.column_stack([columns, rows]) + (size - 1) / 2
    pixels = (centres + 0.5) * patterns.shrink - 0.5 + (left, top)
    spots = plane.world(pixels.reshape(-1, 2), marker.height_m)
    return np.column_stack([spots, patterns.yaws[turned[rows, columns]]])


def _peaks(likeness: NDArray[Any]) -> tuple[list[int], list[int]]:
    import cv2

    highest = cv2.dilate(likeness, np.ones((5, 5), np.uint8))
    rows, columns = np.nonzero((likeness >= highest) & (likeness > 0))
    order = np.argsort(likeness[rows, columns])[::-1][:SPOTS]
    return rows[order].tolist(), columns[order].tolist()
