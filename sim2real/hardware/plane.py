"""Model of a camera above the pool: projection between pixels and horizontal planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array

ITERATIONS, CLOSE_ENOUGH = 50, 1e-10


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with the distortion of Brown and Conrady.

    Attributes:
        size_px: Width and height of the pictures of the calibration.
        matrix: Focal lengths and principal point in pixels, shape (3, 3).
        distortion: k1, k2, p1, p2, k3 in OpenCV's order.
        rms_px: RMS reprojection error of the calibration.
    """

    size_px: tuple[int, int]
    matrix: Array
    distortion: Array
    rms_px: float = float("nan")


def directions(lens: Lens, pixels: Array) -> Array:
    """Directions of pixels (N, 2): x / z and y / z in camera axes, shape (N, 2).

    The distortion has no inverse in closed form; OpenCV's fixed-point iteration runs to 1e-10.
    """
    import cv2

    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, ITERATIONS, CLOSE_ENOUGH)
    points = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    undistorted = cv2.undistortPoints(points, lens.matrix, lens.distortion, None, None, None, stop)
    return np.asarray(undistorted, dtype=np.float64).reshape(-1, 2)


def seen_at(lens: Lens, points: Array) -> Array:
    """Projection of points (N, 3) in camera axes to pixels (N, 2)."""
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
    """A camera above a world with z up and the pool's corners in the plane z = 0.

    Attributes:
        lens: The camera's lens.
        rotation: From world to camera axes, shape (3, 3).
        translation: The world's origin in camera axes, m, shape (3,).
        residual_px: RMS distance between measured and projected corners.
    """

    lens: Lens
    rotation: Array
    translation: Array
    residual_px: float = 0.0

    @property
    def position(self) -> Array:
        """Position of the camera in the world, m, shape (3,)."""
        position: Array = -self.rotation.T @ self.translation
        return position

    def homography(self, height: float) -> Array:
        """From x, y, 1 in the plane z = ``height`` to undistorted directions, shape (3, 3)."""
        right, leftward, up = self.rotation.T
        return np.column_stack([right, leftward, self.translation + height * up])

    def world(self, pixels: Array, height: float = 0.0) -> Array:
        """x, y in m of pixels (N, 2) in the plane z = ``height``, shape (N, 2)."""
        rays = directions(self.lens, pixels)
        inverse = np.linalg.inv(self.homography(height))
        homogeneous = rays @ inverse[:, :2].T + inverse[:, 2]
        result: Array = homogeneous[:, :2] / homogeneous[:, 2:]
        return result

    def pixels(self, points: Array, height: float = 0.0) -> Array:
        """Pixels (N, 2) of points x, y (N, 2) in the plane z = ``height``."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        level = np.column_stack([points, np.full(len(points), height)])
        return seen_at(self.lens, level @ self.rotation.T + self.translation)

    def pixels_per_m(self, point: Array, height: float = 0.0) -> float:
        """Pixels per metre around x, y (2,), the geometric mean of both directions."""
        step = 0.01
        ahead, leftward, centre = self.pixels(
            np.array([[step, 0], [0, step], [0, 0]]) + point, height
        )
        edges = np.stack([ahead - centre, leftward - centre])
        return float(np.sqrt(abs(np.linalg.det(edges)))) / step


def stand(lens: Lens, corners_px: Array, corners_m: Array) -> Plane:
    """The pose of the camera from four or more corners in the plane z = 0.

    The homography between plane and undistorted corners gives an initial pose (Zhang, IEEE
    PAMI 22 (2000) 1330, section 3.1), which is refined to the least reprojection error.

    Args:
        lens: The lens.
        corners_px: The corners in the picture, shape (N, 2).
        corners_m: The corners in the world, x and y, shape (N, 2).

    Raises:
        ValueError: If no pose of a camera fits the corners.
    """
    import cv2

    objects = np.column_stack([corners_m, np.zeros(len(corners_m))])
    rays = directions(lens, corners_px)
    try:
        solved, turn, shift = cv2.solvePnP(objects, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not solved:
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
