"""A coloured patch on the head: the fallback where no marker can be put on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.hardware.plane import Plane

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

LEAST_PX = 6


@dataclass(frozen=True)
class Blob:
    """A patch, longer than wide, along the head.

    Attributes:
        low_hsv, high_hsv: Its colours in OpenCV's ranges (hue to 180, the others to 255); where
            the low hue is above the high one, the range goes through red.
        height_m: How far it is above the level of the pool's corners.
    """

    low_hsv: Array
    high_hsv: Array
    height_m: float = 0.0


def find_blob(picture: Picture, plane: Plane, blob: Blob) -> Array | None:
    """x, y in m and the direction of the long axis, of either end, of the largest patch; (3,).

    The pixels are taken to the world one by one; their mean and the main axis of their scatter
    are the pose. None where there is no such patch.

    Args:
        picture: Blue, green, red, shape (V, U, 3).
        plane: The camera.
        blob: What to look for.
    """
    import cv2

    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    low, high = blob.low_hsv, blob.high_hsv
    if low[0] <= high[0]:
        mask = cv2.inRange(hsv, low, high)
    else:
        red = cv2.inRange(hsv, low, np.array([180.0, *high[1:]]))
        mask = cv2.bitwise_or(red, cv2.inRange(hsv, np.array([0.0, *low[1:]]), high))
    count, label, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return None
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    rows, columns = np.nonzero(label == largest)
    if rows.size < LEAST_PX:
        return None
    spots = plane.world(np.column_stack([columns, rows]).astype(np.float64), blob.height_m)
    middle = spots.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((spots - middle).T))
    return np.array([*middle, np.arctan2(axes[1, -1], axes[0, -1])])


def ahead(poses: Array) -> Array:
    """Headings of a track of blobs, whose axes may point either way: a robot swims head first.

    Args:
        poses: x, y and axis, shape (T, 3); NaN where missing.

    Returns:
        The same with headings that do not jump and, on the whole, point the way it goes.
    """
    out = np.array(poses)
    known = np.flatnonzero(np.isfinite(out[:, 2]))
    if known.size < 2:
        return out
    out[known, 2] = np.unwrap(out[known, 2], period=np.pi)
    way = np.diff(out[known, :2], axis=0)
    heading = (out[known, 2][1:] + out[known, 2][:-1]) / 2
    forward = way[:, 0] * np.cos(heading) + way[:, 1] * np.sin(heading)
    if forward.sum() < 0:
        out[known, 2] += np.pi
    return out
