"""Tracking of a coloured patch on the head, for robots that cannot carry a marker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Picture
from sim2real.hardware.plane import Plane

LEAST_PX = 6


@dataclass(frozen=True)
class Blob:
    """An elongated patch along the head.

    Attributes:
        low_hsv, high_hsv: Range of its colour in OpenCV's units (hue to 180, the others to 255); if
            the low hue is above the high one, the range includes red.
        height_m: Height above the pool's corners.
    """

    low_hsv: Array
    high_hsv: Array
    height_m: float = 0.0


def find_blob(picture: Picture, plane: Plane, blob: Blob) -> Array | None:
    """x, y in m and direction of the long axis (modulo pi) of the largest patch, shape (3,).

    The pose is the mean and the principal axis of its pixels in world coordinates. None if there
    is no such patch.

    Args:
        picture: Blue, green, red, shape (V, U, 3).
        plane: The camera.
        blob: The patch.
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
    """Resolve the direction of the axes in a track of blobs, as a robot swims head first.

    Args:
        poses: x, y and axis, shape (T, 3); NaN where missing.

    Returns:
        The poses with unwrapped headings that point in the mean direction of motion.
    """
    out = np.array(poses)
    found = np.flatnonzero(np.isfinite(out[:, 2]))
    if found.size < 2:
        return out
    out[found, 2] = np.unwrap(out[found, 2], period=np.pi)
    steps = np.diff(out[found, :2], axis=0)
    heading = (out[found, 2][1:] + out[found, 2][:-1]) / 2
    forward = steps[:, 0] * np.cos(heading) + steps[:, 1] * np.sin(heading)
    if forward.sum() < 0:
        out[found, 2] += np.pi
    return out
