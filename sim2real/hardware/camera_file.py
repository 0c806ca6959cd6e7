"""``camera.toml``: lens, pool corners, and the marker or patch on the robot."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.hardware.blob import Blob
from sim2real.hardware.marker import DICTIONARIES, Marker, size_of
from sim2real.hardware.plane import Lens, Plane, stand
from sim2real.output import write_whole
from sim2real.structured import Fields, finite_number, read_toml


@dataclass(frozen=True)
class Camera:
    """Configuration of a tracker.

    Attributes:
        plane: The camera over the pool.
        corners_m: The pool's corners in the world, in order, shape (N, 2).
        marker: The marker on the head, if there is one.
        blob: The coloured patch on the head, if there is one.
    """

    plane: Plane
    corners_m: Array
    marker: Marker | None = None
    blob: Blob | None = None


def read_camera(path: str | os.PathLike[str]) -> Camera:
    """Read ``camera.toml``.

    Raises:
        InputError: If the file or one of its fields does not conform to the format.
    """
    top = Fields(path, "", read_toml(path))
    lens = _lens(top.table("lens"))
    pool = top.table("pool")
    corners_px, corners_m = (
        _matrix(pool, "corners_px", (None, 2)),
        _matrix(pool, "corners_m", (None, 2)),
    )
    if len(corners_px) != len(corners_m) or len(corners_px) < 4:
        expected = "four or more corners, as many as corners_m has"
        raise InputError(path, "pool.corners_px", f"{len(corners_px)} corners", expected)
    try:
        plane = stand(lens, corners_px, corners_m)
    except ValueError as error:
        raise InputError(path, "pool.corners_px", str(error), "corners seen from above") from None
    marker = _marker(top.table("marker")) if "marker" in top else None
    blob = _blob(top.table("blob")) if "blob" in top else None
    if marker is None and blob is None:
        raise InputError(path, "marker", "nothing", "a table [marker] or [blob]")
    return Camera(plane, corners_m, marker, blob)


def _lens(fields: Fields) -> Lens:
    size = _matrix(fields, "size_px", (2,))
    return Lens(
        (int(size[0]), int(size[1])),
        _matrix(fields, "matrix", (3, 3)),
        _matrix(fields, "distortion", (5,)),
        fields.number("rms_px", low=0) if "rms_px" in fields else float("nan"),
    )


def _marker(fields: Fields) -> Marker:
    name = fields.text("dictionary")
    if name not in DICTIONARIES:
        raise fields.error("dictionary", f"one of {', '.join(DICTIONARIES)}")
    number = fields.number("number", low=0)
    if number != int(number) or number >= size_of(name):
        raise fields.error("number", f"a whole number from 0 to {size_of(name) - 1}")
    return Marker(
        name,
        int(number),
        fields.number("side_m", above=0),
        **{name: fields.number(name) for name in _PLACE if name in fields},
    )


_PLACE = ("height_m", "x_m", "y_m", "yaw_rad")


def _blob(fields: Fields) -> Blob:
    return Blob(
        _matrix(fields, "low_hsv", (3,)),
        _matrix(fields, "high_hsv", (3,)),
        fields.number("height_m") if "height_m" in fields else 0.0,
    )


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
    """Write ``camera.toml``; without a marker its table has values to be filled in.

    Raises:
        InputError: If the folder cannot be written.
    """
    shown = marker or Marker("4x4_50", 0, 0.06)
    lines = [
        "# Made by sim2real calibrate-camera. Lengths in m, angles in rad.",
        "",
        "[lens]",
        f"size_px = {list(lens.size_px)}",
        f"matrix = {_listed(lens.matrix, 6)}",
        f"distortion = {_listed(lens.distortion.ravel(), 8)}",
        f"rms_px = {lens.rms_px:.4f}",
        "",
        "[pool]",
        f"corners_px = {_listed(corners_px, 3)}",
        f"corners_m = {_listed(corners_m, 6)}",
        "",
        "[marker]  # on the head, its printed top towards the nose",
        f'dictionary = "{shown.dictionary}"',
        f"number = {shown.number}",
        f"side_m = {shown.side_m}",
        f"height_m = {shown.height_m}  # above the level of the corners",
        f"x_m = {shown.x_m}  # of its centre, ahead of the head's centre of mass",
        f"y_m = {shown.y_m}",
        f"yaw_rad = {shown.yaw_rad}",
    ]
    return write_whole(path, "\n".join(lines) + "\n")


def _listed(values: Array, digits: int) -> Any:  # noqa: ANN401 - nested lists
    return np.round(np.asarray(values, dtype=np.float64), digits).tolist()
