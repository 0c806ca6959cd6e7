"""Image registration of a marker, accurate to a hundredth of a pixel.

A marker of a few pixels has no usable corners, but all of its edges contribute to its position.
Every pixel near it corresponds to a known point of the plane in which it moves, so lens and
perspective are exact; the blurred image of the print is fitted by Gauss-Newton over x, y, yaw, blur
and the grey levels of paper and ink (Baker and Matthews, Int. J. Comput. Vis. 56 (2004) 221).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from sim2real.arrays import Array, Picture
from sim2real.hardware.plane import Plane

MARGIN_CELLS = 0.4  # width of the white margin that is compared
LARGEST_SIDE_PX = 20.0  # pixels of larger markers are subsampled
ITERATIONS = 12
STILL = 1e-3  # cells
LEAST_BLUR_PX, LARGEST_BLUR_CELLS = 0.25, 1.2
SQRT_2PI = float(np.sqrt(2 * np.pi))


@dataclass(frozen=True)
class Print:
    """A square print in the plane z = ``height_m``.

    Attributes:
        ink: 1 where a cell is black, 0 where it is white, shape (n, n); row 0 is ahead.
        side_m: Side of the print.
        height_m: Height of the plane.
    """

    ink: Array
    side_m: float
    height_m: float

    @property
    def cell_m(self) -> float:
        """Side of a cell."""
        return float(self.side_m / self.ink.shape[0])


@dataclass(frozen=True)
class Sighting:
    """A print found in a frame.

    Attributes:
        pose: x, y in m and yaw in rad, shape (3,).
        sd: Standard deviation of each due to pixel noise, shape (3,).
        likeness: Correlation of the pixels with the fitted image, at most 1.
        blur_m: Standard deviation of the blur, including that of a pixel.
    """

    pose: Array
    sd: Array
    likeness: float
    blur_m: float


def darkness(ink: Array, row: Array, column: Array, blur: float) -> tuple[Array, Array]:
    """Darkness of a blurred print, and its derivatives.

    An edge blurred by a Gaussian is its integral; a print is a sum over the corners of its cells,
    each the product of an edge along the rows and one along the columns.

    Args:
        ink: Cells, shape (n, n).
        row: Positions in cells from the far edge of the print, shape (N,).
        column: Positions in cells from its left edge, shape (N,).
        blur: Standard deviation in cells.

    Returns:
        Darkness from 0 to 1, shape (N,), and its derivatives by row, column and blur, (N, 3).
    """
    edges = np.arange(ink.shape[0] + 1)
    corners = np.diff(np.diff(np.pad(ink, 1), axis=0), axis=1)
    z_row, z_column = (row[:, None] - edges) / blur, (column[:, None] - edges) / blur
    past_row, past_column = ndtr(z_row), ndtr(z_column)
    at_row, at_column = (np.exp(-z * z / 2) / (SQRT_2PI * blur) for z in (z_row, z_column))
    row_sums, row_slopes = past_row @ corners, at_row @ corners
    value = (row_sums * past_column).sum(axis=1)
    slope = np.empty((row.size, 3))
    slope[:, 0] = (row_slopes * past_column).sum(axis=1)
    slope[:, 1] = (row_sums * at_column).sum(axis=1)
    spread = ((at_row * z_row) @ corners) * past_column + row_sums * (at_column * z_column)
    slope[:, 2] = -spread.sum(axis=1)
    return value, slope


def register(
    frame: Picture, plane: Plane, marker: Print, pose: Array, blur_m: float | None = None
) -> Sighting | None:
    """Fit the print to ``frame`` from an initial pose.

    Args:
        frame: Grey levels, shape (V, U).
        plane: The camera.
        marker: The print.
        pose: x, y in m and yaw in rad, within about half a cell and 10 degrees, shape (3,).
        blur_m: Initial blur; default: about half a pixel.

    Returns:
        The sighting, or None if the print would leave the frame or the fit fails. Its likeness
        shows whether the print is present.
    """
    scale = plane.pixels_per_m(pose[:2], marker.height_m)
    patch = _patch(frame, plane, marker, pose, scale)
    if patch is None:
        return None
    grey, spots = patch
    cell, half_cells = marker.cell_m, marker.ink.shape[0] / 2
    smallest, largest = LEAST_BLUR_PX / scale / cell, LARGEST_BLUR_CELLS
    blur = np.clip((0.55 / scale if blur_m is None else blur_m) / cell, smallest, largest)
    x, y, yaw = pose
    for _ in range(ITERATIONS):
        c, s = np.cos(yaw), np.sin(yaw)
        east, north = (spots[:, 0] - x) / cell, (spots[:, 1] - y) / cell
        ahead, leftward = c * east + s * north, c * north - s * east
        compared = np.maximum(np.abs(ahead), np.abs(leftward)) < half_cells + MARGIN_CELLS
        ahead, leftward, values = ahead[compared], leftward[compared], grey[compared]
        if values.size < 24:
            return None
        dark, slope = darkness(marker.ink, half_cells - ahead, half_cells - leftward, float(blur))
        by_ahead, by_left = -slope[:, 0], -slope[:, 1]
        design = np.column_stack([np.ones_like(dark), dark])
        levels = np.linalg.solve(design.T @ design + 1e-9 * np.eye(2), design.T @ values)
        missed = values - design @ levels
        jacobian = np.empty((values.size, 6))
        jacobian[:, :2] = design
        jacobian[:, 2] = levels[1] * (s * by_left - c * by_ahead)
        jacobian[:, 3] = -levels[1] * (s * by_ahead + c * by_left)
        jacobian[:, 4] = levels[1] * (by_ahead * leftward - by_left * ahead)
        jacobian[:, 5] = levels[1] * slope[:, 2] * blur
        normal = jacobian.T @ jacobian
        normal[np.diag_indices(6)] += 1e-3 * np.diag(normal) + 1e-9
        step = np.linalg.solve(normal, jacobian.T @ missed)[2:]
        step *= min(1.0, 1.0 / max(np.abs(step[:2]).max(), np.abs(step[2]) * half_cells, 1e-12))
        x, y, yaw = x + step[0] * cell, y + step[1] * cell, yaw + step[2]
        blur = np.clip(blur * np.exp(np.clip(step[3], -0.5, 0.5)), smallest, largest)
        if np.abs(step[:3]).max() < STILL:
            break
    if levels[1] >= 0:  # white ink on black paper
        return None
    noise = float(missed @ missed) / max(values.size - 6, 1)
    sd = np.sqrt(noise * np.diag(np.linalg.inv(normal))[2:5]) * (cell, cell, 1.0)
    spread = values - values.mean()
    likeness = np.sqrt(max(0.0, 1 - float(missed @ missed) / max(float(spread @ spread), 1e-9)))
    return Sighting(np.array([x, y, yaw]), sd, float(likeness), float(blur) * cell)


def _patch(
    frame: Picture, plane: Plane, marker: Print, pose: Array, scale: float
) -> tuple[Array, Array] | None:
    """Grey levels (N,) of the pixels around a pose, and their positions in the plane (N, 2)."""
    reach = (marker.side_m / 2 + 2 * marker.cell_m) * np.sqrt(2)
    centre = plane.pixels(pose[None, :2], marker.height_m)[0]
    low, high = (
        np.floor(centre - reach * scale).astype(int),
        np.ceil(centre + reach * scale).astype(int),
    )
    rows, columns = frame.shape
    low, high = np.maximum(low, 0), np.minimum(high, (columns - 1, rows - 1))
    if np.any(high - low < reach * scale):
        return None
    stride = max(1, round(marker.side_m * scale / LARGEST_SIDE_PX))
    u, v = np.meshgrid(
        np.arange(low[0], high[0] + 1, stride), np.arange(low[1], high[1] + 1, stride)
    )
    pixels = np.column_stack([u.ravel(), v.ravel()])
    grey = frame[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    return grey, plane.world(pixels, marker.height_m)
