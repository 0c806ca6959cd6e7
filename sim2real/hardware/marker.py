"""The square marker on the robot's head: pattern, size and position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sim2real.arrays import Array

DICTIONARIES = {
    "4x4_50": "DICT_4X4_50",
    "4x4_100": "DICT_4X4_100",
    "5x5_50": "DICT_5X5_50",
    "5x5_100": "DICT_5X5_100",
    "6x6_50": "DICT_6X6_50",
    "6x6_250": "DICT_6X6_250",
    "apriltag_16h5": "DICT_APRILTAG_16H5",
    "apriltag_25h9": "DICT_APRILTAG_25H9",
    "apriltag_36h11": "DICT_APRILTAG_36H11",
}
"""Names in ``camera.toml`` and the corresponding names in OpenCV."""


@dataclass(frozen=True)
class Marker:
    """An ArUco or AprilTag marker; its printed top points to the robot's nose.

    Attributes:
        dictionary: One of ``DICTIONARIES``.
        number: Its id in the dictionary.
        side_m: Side of the black square.
        height_m: Height above the pool's corners.
        x_m: Distance of its centre ahead of the body's reference point.
        y_m: Distance of its centre to the left of it.
        yaw_rad: Anticlockwise rotation on the body.
    """

    dictionary: str
    number: int
    side_m: float
    height_m: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def body(self, poses: Array) -> Array:
        """Body poses (T, 3) of marker poses (T, 3)."""
        yaw = poses[:, 2] - self.yaw_rad
        c, s = np.cos(yaw), np.sin(yaw)
        x = poses[:, 0] - c * self.x_m + s * self.y_m
        y = poses[:, 1] - s * self.x_m - c * self.y_m
        return np.stack([x, y, yaw], axis=1)


def dictionary_of(dictionary: str) -> Any:  # noqa: ANN401 - OpenCV's
    """OpenCV's dictionary of that name."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[dictionary]))


def size_of(dictionary: str) -> int:
    """Number of markers of a dictionary."""
    return int(dictionary_of(dictionary).bytesList.shape[0])


def ink(marker: Marker) -> Array:
    """1 where a cell is black and 0 where it is white, shape (n, n), the border included."""
    import cv2

    words = dictionary_of(marker.dictionary)
    cells = int(words.markerSize) + 2
    printed = cv2.aruco.generateImageMarker(words, marker.number, cells)
    return np.where(np.asarray(printed) > 127, 0.0, 1.0)
