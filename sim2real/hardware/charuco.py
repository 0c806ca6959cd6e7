"""Calibration of a lens with a ChArUco board, and detection of markers on the pool's corners."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim2real.arrays import Array, Picture
from sim2real.hardware.marker import dictionary_of
from sim2real.hardware.plane import Lens

LEAST_CORNERS = 8
LEAST_VIEWS = 6
MOST_VIEWS = 40
APART_PX = 12.0
"""Smallest mean distance of a view's corners from those of the previous view."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board.

    Attributes:
        squares: Number of squares horizontally and vertically.
        square_m, marker_m: Sides of a square and of the marker in it.
        dictionary: One of ``marker.DICTIONARIES``.
    """

    squares: tuple[int, int]
    square_m: float
    marker_m: float
    dictionary: str

    def drawn(self) -> Any:  # noqa: ANN401 - OpenCV's
        """OpenCV's board."""
        import cv2

        return cv2.aruco.CharucoBoard(
            self.squares, self.square_m, self.marker_m, dictionary_of(self.dictionary)
        )


@dataclass(frozen=True)
class View:
    """Corners of a board in one picture: in pixels (N, 2) and on the board (N, 3)."""

    pixels: Array
    points: Array


def views(
    pictures: Iterable[Picture], board: Board, *, progress: Callable[[], None] = lambda: None
) -> tuple[list[View], tuple[int, int]]:
    """Distinct views of a board, and width and height of the pictures.

    Args:
        pictures: Pictures, grey or in colour.
        board: The board.
        progress: Called after every picture.
    """
    import cv2

    drawn = board.drawn()
    detector = cv2.aruco.CharucoDetector(drawn)
    selected: list[View] = []
    size = (0, 0)
    previous: dict[int, Array] = {}
    for picture in pictures:
        progress()
        size = (picture.shape[1], picture.shape[0])
        corners, ids, _, _ = detector.detectBoard(picture)
        if ids is None or corners is None or len(ids) < LEAST_CORNERS:
            continue
        points_px = np.reshape(np.asarray(corners, dtype=np.float64), (-1, 2))
        current = {int(k): points_px[n] for n, k in enumerate(np.ravel(ids))}
        common = current.keys() & previous.keys()
        if (
            common
            and np.mean([np.linalg.norm(current[k] - previous[k]) for k in common]) < APART_PX
        ):
            continue
        points, pixels = drawn.matchImagePoints(corners, ids)
        image_points = np.reshape(np.asarray(pixels, dtype=np.float64), (-1, 2))
        selected.append(
            View(image_points, np.reshape(np.asarray(points, dtype=np.float64), (-1, 3)))
        )
        previous = current
    if len(selected) > MOST_VIEWS:
        selected = [selected[k] for k in np.linspace(0, len(selected) - 1, MOST_VIEWS).astype(int)]
    return selected, size


def calibrate(chosen: Sequence[View], size: tuple[int, int]) -> Lens:
    """Focal lengths, principal point and distortion by least squares (Zhang, PAMI 22 (2000) 1330).

    Raises:
        ValueError: If there are too few views.
    """
    import cv2

    if len(chosen) < LEAST_VIEWS:
        raise ValueError(f"{len(chosen)} views of the board, {LEAST_VIEWS} are needed")
    objects = [view.points.astype(np.float32) for view in chosen]
    images = [view.pixels.astype(np.float32) for view in chosen]
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5)
    )
    coefficients = np.ravel(np.asarray(distortion, dtype=np.float64))[:5]
    return Lens(size, np.asarray(matrix, dtype=np.float64), coefficients, float(rms))


def corner_markers(picture: Picture, dictionary: str, numbers: Sequence[int]) -> Array:
    """Centres in pixels of markers on the pool's corners, in the order of ``numbers``.

    Raises:
        ValueError: If one is not found.
    """
    import cv2

    detector = cv2.aruco.ArucoDetector(dictionary_of(dictionary))
    corners, ids, _ = detector.detectMarkers(picture)
    found = {} if ids is None else dict(zip(np.ravel(ids).tolist(), corners, strict=True))
    missing = [number for number in numbers if number not in found]
    if missing:
        raise ValueError(f"marker {missing[0]} was not found; found: {sorted(found) or 'none'}")
    out = []
    for number in numbers:
        a, b, c, d = np.reshape(found[number], (4, 2)).astype(np.float64)
        # the diagonals intersect at the centre under any perspective
        matrix = np.column_stack([c - a, -(d - b)])
        out.append(a + (c - a) * np.linalg.solve(matrix, b - a)[0])
    return np.array(out)
