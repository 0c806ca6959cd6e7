"""A lens: which way each pixel looks, and where a direction is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ITERATIONS, CLOSE_ENOUGH = 50, 1e-10


@dataclass(frozen=True)
class Lens:
    """A pinhole with the distortion of Brown and Conrady.

    Attributes:
        size_px: Width and height of the picture it was calibrated for.
        matrix: Focal lengths and principal point in pixels, shape (3, 3).
        distortion: k1, k2, p1, p2, k3 in OpenCV's order.
        rms_px: RMS reprojection error of the calibration.
    """

    size_px: tuple[int, int]
    matrix: Array
    distortion: Array
    rms_px: float = float("nan")


def directions(lens: Lens, pixels: Array) -> Array:
    """Where pixels (N, 2) look: x / z and y / z in the camera's axes, shape (N, 2).

    The distortion has no inverse in closed form; OpenCV's fixed point is run to 1e-10.
    """
    import cv2

    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ITERATIONS, CLOSE_ENOUGH)
    points = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    looked = cv2.undistortPoints(points, lens.matrix, lens.distortion, None, None, None, stop)
    return np.asarray(looked, dtype=np.float64).reshape(-1, 2)


def seen_at(lens: Lens, points: Array) -> Array:
    """The pixels (N, 2) at which points (N, 3) in the camera's axes are seen."""
    import cv2

    none = np.zeros(3)
    pixels, _ = cv2.projectPoints(
        np.asarray(points, dtype=np.float64).reshape(-1, 1, 3),
        none,
        none,
        lens.matrix,
        lens.distortion,
    )
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
