"""A camera above the pool: which way each pixel looks, and the level that it sees."""

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


@dataclass(frozen=True)
class Plane:
    """A camera over a world whose z is up and whose level z = 0 holds the pool's corners.

    Attributes:
        lens: The camera's lens.
        rotation: From world to camera axes, shape (3, 3).
        translation: The world's origin in camera axes, m, shape (3,).
        residual_px: RMS distance between the given corners and where this camera sees them.
    """

    lens: Lens
    rotation: Array
    translation: Array
    residual_px: float = 0.0

    @property
    def position(self) -> Array:
        """Where the camera is in the world, m, shape (3,)."""
        at: Array = -self.rotation.T @ self.translation
        return at

    def homography(self, height: float) -> Array:
        """From x, y, 1 on the level z = ``height`` to undistorted directions, shape (3, 3)."""
        right, left, up = self.rotation.T
        return np.column_stack([right, left, self.translation + height * up])

    def world(self, pixels: Array, height: float = 0.0) -> Array:
        """x, y in m where pixels (N, 2) look at the level z = ``height``, shape (N, 2)."""
        seen = directions(self.lens, pixels)
        back = np.linalg.inv(self.homography(height))
        on = seen @ back[:, :2].T + back[:, 2]
        result: Array = on[:, :2] / on[:, 2:]
        return result

    def pixels(self, points: Array, height: float = 0.0) -> Array:
        """Pixels (N, 2) at which x, y (N, 2) on the level z = ``height`` are seen."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        level = np.column_stack([points, np.full(len(points), height)])
        return seen_at(self.lens, level @ self.rotation.T + self.translation)

    def pixels_per_m(self, point: Array, height: float = 0.0) -> float:
        """How many pixels a metre takes around x, y (2,), the mean of both directions."""
        step = 0.01
        ahead, left, here = self.pixels(np.array([[step, 0], [0, step], [0, 0]]) + point, height)
        across = np.stack([ahead - here, left - here])
        return float(np.sqrt(abs(np.linalg.det(across)))) / step


def stand(lens: Lens, corners_px: Array, corners_m: Array) -> Plane:
    """The camera's stand from four or more corners of the level z = 0.

    The homography between the level and the undistorted corners gives a first pose (Zhang, IEEE
    PAMI 22 (2000) 1330, section 3.1), which is then refined to the least reprojection error.

    Args:
        lens: The camera's lens.
        corners_px: The corners in the picture, shape (N, 2).
        corners_m: The same in the world, x and y, shape (N, 2).

    Raises:
        ValueError: If no camera can see such corners there.
    """
    import cv2

    objects = np.column_stack([corners_m, np.zeros(len(corners_m))])
    seen = directions(lens, corners_px)
    try:
        found, turn, shift = cv2.solvePnP(objects, seen, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not found:
            raise ValueError("no camera sees such corners")
        turn, shift = cv2.solvePnPRefineLM(
            objects, np.asarray(corners_px, dtype=np.float64), lens.matrix, lens.distortion,
            turn, shift,
        )  # fmt: skip
    except cv2.error as error:
        raise ValueError("no camera sees such corners") from error
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    plane = Plane(lens, rotation, np.asarray(shift, dtype=np.float64).ravel())
    missed = plane.pixels(corners_m) - corners_px
    residual = float(np.sqrt(np.mean(np.sum(missed**2, axis=1))))
    return Plane(lens, plane.rotation, plane.translation, residual)
