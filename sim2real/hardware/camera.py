"""The overhead camera: its calibration, projection, what it looks for, and ``camera.toml``."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array, Picture
from sim2real.errors import InputError
from sim2real.output import write_whole
from sim2real.structured import Fields, finite_number, read_toml

DICTIONARIES = (
    "4x4_50", "4x4_100", "5x5_50", "5x5_100", "6x6_50", "6x6_250", "apriltag_16h5",
    "apriltag_25h9", "apriltag_36h11",
)  # fmt: skip
View = tuple[Array, Array]
"""Corners of a board in one picture: in pixels (N, 2) and on the board (N, 3)."""


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with the distortion of Brown and Conrady (k1, k2, p1, p2, k3 in OpenCV).

    ``size_px`` are width and height of the pictures of the calibration, ``matrix`` (3, 3) has focal
    lengths and principal point in pixels, ``rms_px`` is the reprojection error.
    """

    size_px: tuple[int, int]
    matrix: Array
    distortion: Array
    rms_px: float = float("nan")


@dataclass(frozen=True)
class Plane:
    """A camera above a world with z up and the pool's corners in the plane z = 0.

    Rotation (3, 3) and translation (3,) lead from the world to camera axes, in m.
    """

    lens: Lens
    rotation: Array
    translation: Array

    def raised(self, height_m: float) -> Plane:
        """The same camera above the plane at a height."""
        return replace(self, translation=self.translation + height_m * self.rotation[:, 2])

    @property
    def position(self) -> Array:
        """Position of the camera in the world, m, shape (3,)."""
        return np.asarray(-self.rotation.T @ self.translation)

    def world(self, pixels: Array) -> Array:
        """x, y in m of pixels (N, 2) in the plane z = 0, (N, 2), by iteration to 1e-10."""
        import cv2

        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
        homography = np.column_stack([self.rotation[:, :2], self.translation])
        points = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        back, lens = np.linalg.inv(homography), self.lens
        found = cv2.undistortPoints(
            points, lens.matrix, lens.distortion, None, back, np.eye(3), stop
        )
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    def pixels(self, points: Array) -> Array:
        """Pixels (N, 2) of points x, y (N, 2) in the plane z = 0."""
        import cv2

        flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        level, lens = np.column_stack([flat, np.zeros(len(flat))]), self.lens
        seen, _ = cv2.projectPoints(
            level[:, None], self.rotation, self.translation, lens.matrix, lens.distortion
        )
        return np.asarray(seen, dtype=np.float64).reshape(-1, 2)

    def pixels_per_m(self, point: Array, step: float = 0.01) -> float:
        """Pixels per metre around x, y (2,), the geometric mean of both directions."""
        around = np.array([[step, 0], [0, step], [0, 0]]) + point
        ahead, leftward, centre = self.pixels(around)
        edges = np.stack([ahead - centre, leftward - centre])
        return float(np.sqrt(abs(np.linalg.det(edges)))) / step


def stand(lens: Lens, corners_px: Array, corners_m: Array) -> Plane:
    """The pose of the camera from corners in the picture (N, 2) and in the plane z = 0, m, (N, 2).

    It has the least reprojection error, from a start by the homography of the corners (Zhang, IEEE
    PAMI 22 (2000) 1330, section 3.1). ``ValueError`` if no pose of a camera fits the corners.
    """
    import cv2

    objects = np.column_stack([corners_m, np.zeros(len(corners_m))])
    seen = (np.asarray(corners_px, dtype=np.float64), lens.matrix, lens.distortion)
    try:
        solved, turn, shift = cv2.solvePnP(objects, *seen, flags=cv2.SOLVEPNP_IPPE)
        if not solved:
            raise ValueError("no camera sees such corners")
        turn, shift = cv2.solvePnPRefineLM(objects, *seen, turn, shift)
    except cv2.error as error:
        raise ValueError("no camera sees such corners") from error
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    return Plane(lens, rotation, np.asarray(shift, dtype=np.float64).ravel())


@dataclass(frozen=True)
class Marker:
    """An ArUco or AprilTag marker; its printed top points to the robot's nose.

    Its centre is ``x_m`` ahead and ``y_m`` to the left of the body's reference point, ``height_m``
    above the pool's corners; it is turned anticlockwise by ``yaw_rad``.
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

    def ink(self) -> Array:
        """1 where a cell is black and 0 where it is white, shape (n, n), the border included."""
        import cv2

        words = dictionary_of(self.dictionary)
        cells = int(words.markerSize) + 2
        printed = cv2.aruco.generateImageMarker(words, self.number, cells)
        return np.where(np.asarray(printed) > 127, 0.0, 1.0)


@dataclass(frozen=True)
class Blob:
    """An elongated patch along the head.

    The range of its colour is in OpenCV's units (hue to 180, the others to 255); if the low hue is
    above the high one, the range includes red. The height is that above the pool's corners.
    """

    low_hsv: Array
    high_hsv: Array
    height_m: float = 0.0


@dataclass(frozen=True)
class Camera:
    """Configuration of a tracker: the camera, the pool's corners in m (N, 2), and a target."""

    plane: Plane
    corners_m: Array
    marker: Marker | None = None
    blob: Blob | None = None


def dictionary_of(dictionary: str) -> Any:  # noqa: ANN401 - OpenCV's
    """OpenCV's dictionary of that name."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary.upper()}"))


def charuco_board(
    squares: tuple[int, int], square_m: float, marker_m: float, dictionary: str
) -> Any:  # noqa: ANN401 - OpenCV's
    """OpenCV's board of so many squares across and down, with the sides of square and marker."""
    import cv2

    return cv2.aruco.CharucoBoard(squares, square_m, marker_m, dictionary_of(dictionary))


def read_camera(path: str | os.PathLike[str]) -> Camera:
    """Read ``camera.toml``; ``InputError`` if it does not conform to the format."""
    top = Fields(path, "", read_toml(path))
    glass, pool = top.table("lens"), top.table("pool")
    width, height = _matrix(glass, "size_px", (2,))
    rms_px = glass.number("rms_px", float("nan"), low=0)
    matrix, distortion = _matrix(glass, "matrix", (3, 3)), _matrix(glass, "distortion", (5,))
    lens = Lens((int(width), int(height)), matrix, distortion, rms_px)
    corners_px, corners_m = (_matrix(pool, f"corners_{unit}", (None, 2)) for unit in ("px", "m"))
    if len(corners_px) != len(corners_m) or len(corners_px) < 4:
        expected = "four or more corners, as many as corners_m has"
        raise InputError(path, "pool.corners_px", f"{len(corners_px)} corners", expected)
    try:
        plane = stand(lens, corners_px, corners_m)
    except ValueError as error:
        raise InputError(path, "pool.corners_px", str(error), "corners seen from above") from None
    if "marker" not in top and "blob" not in top:
        raise InputError(path, "marker", "nothing", "a table [marker] or [blob]")
    marker = blob = None
    if "marker" in top:
        fields = top.table("marker")
        name = fields.text("dictionary")
        if name not in DICTIONARIES:
            raise fields.error("dictionary", f"one of {', '.join(DICTIONARIES)}")
        number, count = fields.number("number", low=0), int(dictionary_of(name).bytesList.shape[0])
        if number != int(number) or number >= count:
            raise fields.error("number", f"a whole number from 0 to {count - 1}")
        place = {x: fields.number(x, 0.0) for x in ("height_m", "x_m", "y_m", "yaw_rad")}
        marker = Marker(name, int(number), fields.number("side_m", above=0), **place)
    if "blob" in top:
        patch = top.table("blob")
        low, high = (_matrix(patch, f"{end}_hsv", (3,)) for end in ("low", "high"))
        blob = Blob(low, high, patch.number("height_m", 0.0))
    return Camera(plane, corners_m, marker, blob)


def _matrix(fields: Fields, name: str, shape: tuple[int | None, ...]) -> Array:
    """Nested lists of finite numbers of a shape; None for any length."""
    words = " by ".join("some" if n is None else str(n) for n in shape) + " numbers"
    try:
        values = np.array(fields.content[name], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        raise fields.error(name, words) from None
    fits = values.ndim == len(shape) and all(
        n is None or n == m for n, m in zip(shape, values.shape, strict=True)
    )
    if not fits or any(finite_number(x) is None for x in values.ravel().tolist()):
        raise fields.error(name, words)
    return values


def write_camera(
    path: str | os.PathLike[str],
    lens: Lens,
    corners_px: Array,
    corners_m: Array,
    marker: Marker | None = None,
) -> Path:
    """Write ``camera.toml``; without a marker its table has values to be filled in."""
    shown = marker or Marker("4x4_50", 0, 0.06)

    def listed(values: Array, digits: int) -> object:
        return np.round(np.asarray(values, dtype=np.float64), digits).tolist()

    text = f"""# Made by sim2real calibrate-camera. Lengths in m, angles in rad.

[lens]
size_px = {list(lens.size_px)}
matrix = {listed(lens.matrix, 6)}
distortion = {listed(lens.distortion.ravel(), 8)}
rms_px = {lens.rms_px:.4f}

[pool]
corners_px = {listed(corners_px, 3)}
corners_m = {listed(corners_m, 6)}

[marker]  # on the head, its printed top towards the nose
dictionary = "{shown.dictionary}"
number = {shown.number}
side_m = {shown.side_m}
height_m = {shown.height_m}  # above the level of the corners
x_m = {shown.x_m}  # of its centre, ahead of the head's centre of mass
y_m = {shown.y_m}
yaw_rad = {shown.yaw_rad}
"""
    return write_whole(path, text)


def views(
    pictures: Iterable[Picture],
    board: Any,  # noqa: ANN401 - OpenCV's
    *,
    progress: Callable[[], None] = lambda: None,
    most: int = 40,
    apart_px: float = 12.0,
) -> tuple[list[View], tuple[int, int]]:
    """Distinct views of OpenCV's ``CharucoBoard``, and width and height of the pictures.

    ``progress`` is called after every picture. There are ``most`` views at most; the corners of
    successive ones are ``apart_px`` apart on average.
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
        if moved and np.mean(moved) < apart_px:
            continue
        selected.append((pixels, np.asarray(board.getChessboardCorners())[np.ravel(ids)]))
        previous = current
    if len(selected) > most:
        selected = [selected[k] for k in np.linspace(0, len(selected) - 1, most).astype(int)]
    return selected, size


def calibrate(chosen: Sequence[View], size: tuple[int, int], *, fewest: int = 6) -> Lens:
    """The lens by least squares (Zhang, PAMI 22 (2000) 1330); ``ValueError`` with too few views."""
    import cv2

    if len(chosen) < fewest:
        raise ValueError(f"{len(chosen)} views of the board, {fewest} are needed")
    images, objects = ([view[k].astype(np.float32) for view in chosen] for k in (0, 1))
    rms, matrix, distortion, _, _ = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5)
    )
    coefficients = np.ravel(np.asarray(distortion, dtype=np.float64))[:5]
    return Lens(size, np.asarray(matrix, dtype=np.float64), coefficients, float(rms))
