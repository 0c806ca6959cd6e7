"""Search for a print in a frame by a matched filter.

OpenCV's detector needs a marker of about 20 pixels. This filter uses the known print, size and
level, and finds it at 8 pixels, by comparing all positions with the print at all angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array, Array32, Picture
from sim2real.hardware.plane import Plane
from sim2real.hardware.registration import Print, darkness

YAWS = 24
SIDE_PX = 12.0  # larger prints are searched in a picture of lower resolution
SPOTS = 12
BLUR_PX = 0.55
QUIET_CELLS = 0.6  # width of the white margin in a pattern


@dataclass(frozen=True)
class Bank:
    """Images of a print at all angles.

    Attributes:
        patterns: Grey levels from 0 to 1, shape (K, side, side).
        masks: 1 within the print and its white margin, same shape.
        yaws: Their angles in the world, rad, shape (K,).
        shrink: Pixels of the frame per pixel of a pattern.
    """

    patterns: Array32
    masks: Array32
    yaws: Array
    shrink: float


def bank(plane: Plane, marker: Print) -> Bank:
    """The patterns in the middle of the frame."""
    middle = (np.array(plane.lens.size_px) - 1) // 2
    centre_m = plane.world(middle[None], marker.height_m)[0]
    side = marker.side_m * plane.pixels_per_m(centre_m, marker.height_m)
    shrink = max(1.0, side / SIDE_PX)
    cells = marker.ink.shape[0]
    radius = int(np.ceil(side / shrink * (0.5 + QUIET_CELLS / cells) * np.sqrt(2)))
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
    spots = plane.world(middle + shrink * np.column_stack([u.ravel(), v.ravel()]), marker.height_m)
    east, north = ((spots - centre_m) / marker.cell_m).T
    blur = BLUR_PX / SIDE_PX * cells * max(1.0, SIDE_PX / side)
    yaws = np.arange(YAWS) * 2 * np.pi / YAWS
    patterns, masks = np.empty((2, YAWS, 2 * radius + 1, 2 * radius + 1), dtype=np.float32)
    for k, yaw in enumerate(yaws):
        c, s = np.cos(yaw), np.sin(yaw)
        ahead, leftward = c * east + s * north, c * north - s * east
        dark, _ = darkness(marker.ink, cells / 2 - ahead, cells / 2 - leftward, blur)
        patterns[k] = (1 - dark).reshape(u.shape)
        within = np.maximum(np.abs(ahead), np.abs(leftward)) < cells / 2 + QUIET_CELLS
        masks[k] = within.reshape(u.shape)
    return Bank(patterns, masks, yaws, shrink)


def search(
    frame: Picture, plane: Plane, marker: Print, patterns: Bank, window: tuple[int, int, int, int]
) -> Array:
    """Candidate poses, the most similar first.

    Args:
        frame: Grey levels, shape (V, U).
        plane: The camera.
        marker: The print.
        patterns: Its images.
        window: First column and row, last column and row (exclusive) of the search.

    Returns:
        Poses, shape (N, 3); N may be 0.
    """
    import cv2

    size = patterns.patterns.shape[1]
    left, top, right, bottom = window
    part: NDArray[Any] = frame[top:bottom, left:right]
    if patterns.shrink > 1:
        shrunk = np.maximum(np.round(np.array(part.shape[::-1]) / patterns.shrink), 1).astype(int)
        part = cv2.resize(part, (int(shrunk[0]), int(shrunk[1])), interpolation=cv2.INTER_AREA)
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
