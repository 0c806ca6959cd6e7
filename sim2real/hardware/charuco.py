"""A lens from pictures of a ChArUco board, and the pool's corners from markers that lie on them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.hardware.marker import dictionary_of
from sim2real.hardware.plane import Lens

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

LEAST_CORNERS = 8
LEAST_VIEWS = 6
MOST_VIEWS = 40
APART_PX = 12.0
"""A view counts whose corners lie this far from those of the last that did, on average."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board.

    Attributes:
        squares: Squares across and down.
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
    """Corners of a board in one picture: in it (N, 2) and on the board (N, 3)."""

    pixels: Array
    points: Array


def views(
    pictures: Iterable[Picture], board: Board, *, progress: Callable[[], None] = lambda: None
) -> tuple[list[View], tuple[int, int]]:
    """Views of a board that tell something new, and the pictures' width and height.

    Args:
        pictures: Grey or in colour.
        board: What to look for.
        progress: Called after every picture.
    """
    import cv2

    drawn = board.drawn()
    detector = cv2.aruco.CharucoDetector(drawn)
    found: list[View] = []
    size = (0, 0)
    last: dict[int, Array] = {}
    for picture in pictures:
        progress()
        size = (picture.shape[1], picture.shape[0])
        corners, ids, _, _ = detector.detectBoard(picture)
        if ids is None or corners is None or len(ids) < LEAST_CORNERS:
            continue
        at = np.reshape(np.asarray(corners, dtype=np.float64), (-1, 2))
        here = {int(k): at[n] for n, k in enumerate(np.ravel(ids))}
        both = here.keys() & last.keys()
        if both and np.mean([np.linalg.norm(here[k] - last[k]) for k in both]) < APART_PX:
            continue
        points, pixels = drawn.matchImagePoints(corners, ids)
        seen = np.reshape(np.asarray(pixels, dtype=np.float64), (-1, 2))
        found.append(View(seen, np.reshape(np.asarray(points, dtype=np.float64), (-1, 3))))
        last = here
    if len(found) > MOST_VIEWS:
        found = [found[k] for k in np.linspace(0, len(found) - 1, MOST_VIEWS).astype(int)]
    return found, size


def calibrate(seen: Sequence[View], size: tuple[int, int]) -> Lens:
    """Focal lengths, principal point and distortion by least squares (Zhang, PAMI 22 (2000) 1330).

    Raises:
        ValueError: If there are too few views.
    """
    import cv2

    if len(seen) < LEAST_VIEWS:
        raise ValueError(f"{len(seen)} views of the board, {LEAST_VIEWS} are needed")
    objects = [view.points.astype(np.float32) for view in seen]
    images = [view.pixels.astype(np.float32) for view in seen]
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5)
    )
    bent = np.ravel(np.asarray(distortion, dtype=np.float64))[:5]
    return Lens(size, np.asarray(matrix, dtype=np.float64), bent, float(rms))


def corner_markers(picture: Picture, dictionary: str, numbers: Sequence[int]) -> Array:
    """Centres in pixels of markers that lie on the pool's corners, in the order of ``numbers``.

    Raises:
        ValueError: If one is not seen.
    """
    import cv2

    detector = cv2.aruco.ArucoDetector(dictionary_of(dictionary))
    corners, ids, _ = detector.detectMarkers(picture)
    seen = {} if ids is None else dict(zip(np.ravel(ids).tolist(), corners, strict=True))
    missing = [number for number in numbers if number not in seen]
    if missing:
        raise ValueError(f"marker {missing[0]} is not seen; {sorted(seen) or 'none'} are")
    out = []
    for number in numbers:
        a, b, c, d = np.reshape(seen[number], (4, 2)).astype(np.float64)
        # where the diagonals cross is the centre, whatever the perspective
        matrix = np.column_stack([c - a, -(d - b)])
        out.append(a + (c - a) * np.linalg.solve(matrix, b - a)[0])
    return np.array(out)
