"""A marker in a frame: a search by a matched filter, and image registration to 0.01 pixel.

A marker of a few pixels has no usable corners (OpenCV's detector needs about 20 pixels), but all of
its edges contribute to its position. Every pixel near it corresponds to a known point of the plane
in which it moves, so lens and perspective are exact; the blurred image of the print is fitted over
x, y, yaw and blur, with the grey levels of paper and ink, by least squares (Baker and Matthews,
Int. J. Comput. Vis. 56 (2004) 221).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sim2real.arrays import Array, Array32, Mask, Picture
from sim2real.hardware.camera import Marker, Plane

MARGIN_CELLS = 0.4
"""Width of the white margin that is compared."""
SUBSAMPLED_PX, SHRUNK_PX = 20.0, 12.0
"""Sides from which on a marker is registered on fewer pixels, searched at a lower resolution."""
USUAL_BLUR_PX = 0.55


@dataclass(frozen=True)
class Sighting:
    """A marker found in a frame.

    ``pose`` is x, y in m and yaw in rad, ``likeness`` the correlation of the pixels with the fitted
    image, at most 1, ``blur_m`` the standard deviation of the blur, including that of a pixel.
    """

    pose: Array
    likeness: float
    blur_m: float


def darkness(ink: Array, row: Array, column: Array, blur: float) -> Array:
    """Darkness of a blurred print from 0 to 1, shape (N,).

    An edge blurred by a Gaussian is its integral; a print is a sum over the corners of its cells,
    each the product of an edge along the rows and one along the columns. Rows and columns (N,) are
    counted from the far left corner of the print, whose cells are ``ink``; they and the standard
    deviation ``blur`` are in cells.
    """
    edges = np.arange(ink.shape[0] + 1)
    corners = np.diff(np.diff(np.pad(ink, 1), axis=0), axis=1)
    past_row, past_column = (ndtr((x[:, None] - edges) / blur) for x in (row, column))
    result: Array = ((past_row @ corners) * past_column).sum(axis=1)
    return result


class Finder:
    """Finds one marker in grey frames of one camera."""

    def __init__(self, plane: Plane, marker: Marker) -> None:
        self.plane, self.ink = plane.raised(marker.height_m), marker.ink()
        self.side_m, self.cell_m = marker.side_m, marker.side_m / len(self.ink)
        middle = (np.array(plane.lens.size_px) - 1) // 2
        side_px = self.side_m * self.plane.pixels_per_m(self.plane.world(middle[None])[0])
        self._shrink = max(1.0, side_px / SHRUNK_PX)
        self._yaws = np.arange(24) * 2 * np.pi / 24
        self._patterns = self._rendered(side_px, middle)

    def register(self, frame: Picture, pose: Array, blur_m: float | None = None) -> Sighting | None:
        """Fit the print to a grey ``frame`` (V, U) from a pose within half a cell and 10 degrees.

        None if the print would leave the frame or the fit fails; the likeness shows whether it is
        there.
        """
        from scipy.optimize import least_squares

        scale = self.plane.pixels_per_m(pose[:2])
        patch = self._patch(frame, pose, scale)
        if patch is None or patch[0].size < 24:
            return None
        grey, spots = patch
        blur = (USUAL_BLUR_PX / scale if blur_m is None else blur_m) / self.cell_m
        narrowest, widest = np.log(0.25 / scale / self.cell_m), np.log(1.2)

        def missed(x: Array) -> tuple[Array, Array, Mask]:
            """What the fit leaves (N,), levels of paper and ink - paper, and pixels compared."""
            at = pose + x[:3] * (self.cell_m, self.cell_m, 1.0)
            width = float(np.exp(np.clip(x[3], narrowest, widest)))
            ahead, leftward = self._in_cells(spots, at)
            half = len(self.ink) / 2
            compared = np.maximum(np.abs(ahead), np.abs(leftward)) < half + MARGIN_CELLS
            dark = darkness(self.ink, half - ahead[compared], half - leftward[compared], width)
            design = np.column_stack([np.ones_like(dark), dark])
            normal = design.T @ design + 1e-9 * np.eye(2)
            levels = np.linalg.solve(normal, design.T @ grey[compared]).astype(np.float64)
            out = np.zeros(grey.size)
            out[compared] = grey[compared] - design @ levels
            return out, levels, compared

        def residual(x: Array) -> Array:
            return missed(x)[0]

        start = np.array([0.0, 0.0, 0.0, np.clip(np.log(blur), narrowest, widest)])
        fit = least_squares(
            residual, start, method="lm", x_scale=(0.3, 0.3, 0.1, 0.3), xtol=1e-3,
            ftol=1e-3, gtol=1e-6, max_nfev=60,
        )  # fmt: skip
        left, levels, compared = missed(fit.x)
        values = grey[compared]
        if values.size < 24 or levels[1] >= 0:  # too few, or white ink on black paper
            return None
        spread = float(((values - values.mean()) ** 2).sum())
        likeness = np.sqrt(max(0.0, 1 - float(left @ left) / max(spread, 1e-9)))
        found = pose + fit.x[:3] * (self.cell_m, self.cell_m, 1.0)
        width = float(np.exp(np.clip(fit.x[3], narrowest, widest)))
        return Sighting(found, float(likeness), width * self.cell_m)

    def search(self, frame: Picture, window: tuple[int, int, int, int], *, most: int = 6) -> Array:
        """Candidate poses (N, 3) in a window (left, top, right, bottom), the most similar first."""
        import cv2

        left, top, right, bottom = window
        part: NDArray[Any] = frame[top:bottom, left:right]
        if self._shrink > 1:
            width, height = np.maximum(np.round(np.array(part.shape[::-1]) / self._shrink), 1)
            part = cv2.resize(part, (int(width), int(height)), interpolation=cv2.INTER_AREA)
        grey, size = part.astype(np.float32), len(self._patterns[0][0])
        if min(grey.shape) < size:
            return np.empty((0, 3))
        matched = [
            cv2.matchTemplate(grey, shown, cv2.TM_CCOEFF_NORMED, mask=mask)
            for shown, mask in self._patterns
        ]
        likeness = np.nan_to_num(matched, posinf=0.0, neginf=0.0)
        best = likeness.max(axis=0)
        peak = (best >= cv2.dilate(best, np.ones((5, 5), np.uint8))) & (best > 0)
        rows, columns = np.nonzero(peak)
        order = np.argsort(best[rows, columns])[::-1][:most]
        rows, columns = rows[order], columns[order]
        centres = np.column_stack([columns, rows]) + (size - 1) / 2
        pixels = ((centres + 0.5) * self._shrink - 0.5 + (left, top)).astype(np.float64)
        turned = likeness.argmax(axis=0)[rows, columns]
        return np.column_stack([self.plane.world(pixels), self._yaws[turned]])

    def _rendered(self, side_px: float, middle: NDArray[Any]) -> list[tuple[Array32, Array32]]:
        """The marker at all angles in the frame's middle.

        Grey levels from 0 to 1, and 1 within the print and its margin.
        """
        cells, quiet = len(self.ink), 0.6
        radius = int(np.ceil(side_px / self._shrink * (0.5 + quiet / cells) * np.sqrt(2)))
        v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
        around = np.column_stack([u.ravel(), v.ravel()])
        spots = self.plane.world(middle + self._shrink * around)
        centre = self.plane.world(middle[None])[0]
        blur = USUAL_BLUR_PX * cells / min(side_px, SHRUNK_PX)
        rendered = []
        for yaw in self._yaws:
            ahead, leftward = self._in_cells(spots, np.array([*centre, yaw]))
            dark = darkness(self.ink, cells / 2 - ahead, cells / 2 - leftward, blur)
            within = np.maximum(np.abs(ahead), np.abs(leftward)) < cells / 2 + quiet
            shown, mask = (x.reshape(u.shape).astype(np.float32) for x in (1 - dark, within))
            rendered.append((shown, mask))
        return rendered

    def _in_cells(self, spots: Array, pose: Array) -> tuple[Array, Array]:
        """Points of the plane (N, 2) ahead and to the left of a print's centre, in cells."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        east, north = ((spots - pose[:2]) / self.cell_m).T
        return c * east + s * north, c * north - s * east

    def _patch(self, frame: Picture, pose: Array, scale: float) -> tuple[Array, Array] | None:
        """Grey levels (N,) of the pixels around a pose, and their positions in the plane (N, 2)."""
        reach = (self.side_m / 2 + 2 * self.cell_m) * np.sqrt(2) * scale
        centre = self.plane.pixels(pose[None, :2])[0]
        rows, columns = frame.shape
        low = np.maximum(np.floor(centre - reach).astype(int), 0)
        high = np.minimum(np.ceil(centre + reach).astype(int), (columns - 1, rows - 1))
        if np.any(high - low < reach):
            return None
        stride = max(1, round(self.side_m * scale / SUBSAMPLED_PX))
        ranges = (np.arange(low[k], high[k] + 1, stride) for k in (0, 1))
        pixels = np.stack(np.meshgrid(*ranges), axis=-1).reshape(-1, 2)
        return frame[pixels[:, 1], pixels[:, 0]].astype(np.float64), self.plane.world(pixels)
