"""Calibration of a lens with a ChArUco board."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from sim2real.arrays import Array, Picture
from sim2real.hardware.camera import Lens

View = tuple[Array, Array]
"""Corners of a board in one picture: in pixels (N, 2) and on the board (N, 3)."""
APART_PX = 12.0
"""Smallest mean distance of a view's corners from those of the previous view."""


def views(
    pictures: Iterable[Picture],
    board: Any,  # noqa: ANN401 - OpenCV's
    *,
    progress: Callable[[], None] = lambda: None,
    most: int = 40,
) -> tuple[list[View], tuple[int, int]]:
    """Distinct views of OpenCV's ``CharucoBoard``, and width and height of the pictures.

    ``progress`` is called after every picture; there are ``most`` views at most.
    """
    import cv2

    detector = cv2.aruco.CharucoDetector(board)
    selected: list[View] = []
    size = (0, 0)
    previous: dict[int, Array] = {}
    for picture in pictures:
        progress()
        size = (picture.shape[1], picture.shape[0])
        corners, ids, _, _ = detector.detectBoard(picture)
        if ids is None or corners is None or len(ids) < 8:
            continue
        pixels = np.reshape(np.asarray(corners, dtype=np.float64), (-1, 2))
        current = {int(k): pixel for k, pixel in zip(np.ravel(ids), pixels, strict=True)}
        common = current.keys() & previous.keys()
        moved = [float(np.linalg.norm(current[k] - previous[k])) for k in common]
        if moved and np.mean(moved) < APART_PX:
            continue
        selected.append((pixels, np.asarray(board.getChessboardCorners())[np.ravel(ids)]))
        previous = current
    if len(selected) > most:
        selected = [selected[k] for k in np.linspace(0, len(selected) - 1, most).astype(int)]
    return selected, size


def calibrate(chosen: Sequence[View], size: tuple[int, int], *, fewest: int = 6) -> Lens:
    """Focal lengths, principal point and distortion by least squares (Zhang, PAMI 22 (2000) 1330).

    Raises:
        ValueError: If there are too few views.
    """
    import cv2

    if len(chosen) < fewest:
        raise ValueError(f"{len(chosen)} views of the board, {fewest} are needed")
    images, objects = ([view[k].astype(np.float32) for view in chosen] for k in (0, 1))
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5)
    )
    coefficients = np.ravel(np.asarray(distortion, dtype=np.float64))[:5]
    return Lens(size, np.asarray(matrix, dtype=np.float64), coefficients, float(rms))
