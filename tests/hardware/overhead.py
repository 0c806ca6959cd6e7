"""A rendered pool under an overhead camera, to track in.

Light is followed from every pixel to the water and averaged over the pixel and over the exposure.
Nothing here comes from the tracker: lens, perspective and picture are written out once more.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from sim2real.arrays import Array, Picture

POOL_M = 3.6
SIZE = (640, 480)


@dataclass(frozen=True)
class Eye:
    """A camera: where it stands, how it is turned (rows: right, down, ahead) and its lens."""

    position: tuple[float, float, float] = (1.83, 1.76, 3.0)
    tilt: tuple[float, float, float] = (0.02, -0.015, 0.03)
    focal: tuple[float, float] = (400.0, 401.5)
    centre: tuple[float, float] = (322.3, 237.1)
    lens: tuple[float, ...] = (-0.21, 0.045, 0.0007, -0.0005, 0.0)

    @property
    def rotation(self) -> Array:
        down = np.diag([1.0, -1.0, -1.0])
        return cv2.Rodrigues(np.array(self.tilt))[0] @ down

    def bend(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3 = self.lens
        r = x * x + y * y
        radial = 1 + r * (k1 + r * (k2 + r * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x),
            y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y,
        )

    def pixels(self, points: Array) -> Array:
        """Where points (..., 3) of the world are seen, (..., 2)."""
        p = (points - np.array(self.position)) @ self.rotation.T
        bent = self.bend(p[..., 0] / p[..., 2], p[..., 1] / p[..., 2])
        return np.stack(bent, -1) * self.focal + self.centre

    def rays(self, u: Array, v: Array) -> Array:
        """Directions (..., 3) in the camera's axes in which pixels look, by fixed point."""
        seen_x, seen_y = (u - self.centre[0]) / self.focal[0], (v - self.centre[1]) / self.focal[1]
        x, y = seen_x, seen_y
        for _ in range(30):
            bent_x, bent_y = self.bend(x, y)
            off_x, off_y = seen_x - bent_x, seen_y - bent_y
            x, y = x + off_x, y + off_y
            if max(np.abs(off_x).max(), np.abs(off_y).max()) < 1e-7:  # a ten-thousandth of a pixel
                break
        return np.stack([x, y, np.ones_like(x)], -1)

    def plane(self, rays: Array, height: float) -> tuple[Array, Array]:
        """Where rays meet the level z = height: x and y."""
        ahead = rays @ self.rotation
        reach = (height - self.position[2]) / ahead[..., 2]
        return self.position[0] + reach * ahead[..., 0], self.position[1] + reach * ahead[..., 1]


def stuck_on(picture: Array, forward: Array, left: Array, side: float) -> tuple[Array, Array]:
    """Is there paper at a point (given from the marker's centre), and how white is it?"""
    n = picture.shape[0]
    row = np.floor((0.5 - forward / side) * n).astype(int)
    column = np.floor((0.5 - left / side) * n).astype(int)
    inside = (row >= 0) & (row < n) & (column >= 0) & (column < n)
    white = np.where(inside, picture[row.clip(0, n - 1), column.clip(0, n - 1)], 1.0)
    quiet = side * (0.5 + 1 / 6)
    return (np.abs(forward) < quiet) & (np.abs(left) < quiet), white


def tiles(x: Array, y: Array) -> Array:
    """A blue pool with darker joints between tiles, and the dry rim around it."""
    line = (np.mod(x, 0.3) < 0.012) | (np.mod(y, 0.3) < 0.012)
    wet = (x > 0) & (x < POOL_M) & (y > 0) & (y < POOL_M)
    water = np.where(line[..., None], (0.10, 0.22, 0.30), (0.16, 0.36, 0.46))
    shade = 1 + 0.15 * np.sin(2.1 * x + 0.4) * np.cos(1.7 * y)
    return np.where(wet[..., None], water, (0.55, 0.53, 0.50)) * shade[..., None]


@dataclass(frozen=True)
class Shot:
    """How a video is taken, of a dark head with a marker, or with an orange blob, on top."""

    eye: Eye = field(default_factory=Eye)
    number: int = 3
    side: float = 0.06
    height: float = 0.05
    blob: bool = False
    exposure_s: float = 0.008
    noise: float = 4.0  # grey levels
    samples: int = 3  # along each side of a pixel

    def swimmer(self) -> Callable[[Array, Array], tuple[Array, Array]]:
        """A function from a point of the body to: is there body, and its colour."""
        book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        picture = cv2.aruco.generateImageMarker(book, self.number, 480) / 255.0

        def colours(forward: Array, left: Array) -> tuple[Array, Array]:
            body = (np.abs(left) < 0.065 * (1 - (forward / 0.18).clip(-1, 1) ** 4)) & (
                np.abs(forward) < 0.18
            )
            colour = np.where(body[..., None], (0.06, 0.055, 0.05), 0.0)
            if self.blob:
                spot = (forward / 0.08) ** 2 + (left / 0.035) ** 2 < 1
                return body | spot, np.where(spot[..., None], (0.85, 0.30, 0.03), colour)
            paper, white = stuck_on(picture, forward, left, self.side)
            return body | paper, np.where(
                paper[..., None], (0.03 + 0.72 * white)[..., None], colour
            )

        return colours


def swim(t: Array) -> Array:
    """Poses (T, 3) of a swim in a figure of eight, the head swinging at 1.1 Hz; continuous in t."""
    start = np.clip(t - 1.0, 0.0, None)
    s = 0.32 * start**2 / (start + 0.7)  # it gathers way
    phase = s / 0.75
    x = POOL_M / 2 + 1.15 * np.sin(phase + 0.5)
    y = POOL_M / 2 + 1.25 * np.sin(2 * (phase + 0.5)) / 2
    dx, dy = 1.15 * np.cos(phase + 0.5), 1.25 * np.cos(2 * (phase + 0.5))
    swing = 0.16 * np.sin(2 * np.pi * 1.1 * start) * (1 - np.exp(-2 * start))
    return np.stack([x, y, np.unwrap(np.arctan2(dy, dx)) + swing], -1)


def sample_rays(eye: Eye, u: Array, v: Array, samples: int) -> Array:
    """Rays (V, U, samples², 3) through the pixels whose whole coordinates are u and v."""
    step = (np.arange(samples) + 0.5) / samples - 0.5
    du, dv = (part.ravel() for part in np.meshgrid(step, step))
    uu = u[None, :, None] + du + 0 * v[:, None, None]
    vv = v[:, None, None] + dv + 0 * u[None, :, None]
    return eye.rays(uu, vv)


@cache
def still(eye: Eye) -> Array:
    """The pool as the camera sees it, linear, (V, U, 3)."""
    rows = []
    for v in np.array_split(np.arange(SIZE[1], dtype=float), 24):
        rays = sample_rays(eye, np.arange(SIZE[0], dtype=float), v, 2)
        rows.append(tiles(*eye.plane(rays, 0.0)).mean(axis=2))
    return np.concatenate(rows).astype(np.float32)


def with_swimmer(shot: Shot, poses: Array) -> Array:
    """The pool with the swimmer in it, averaged over ``poses`` (K, 3) of one exposure."""
    eye, pool = shot.eye, still(shot.eye)
    picture, (x, y, _) = pool.copy(), poses.mean(axis=0)
    around = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * 0.24 + (x, y)
    corners = eye.pixels(np.column_stack([around, np.full(4, shot.height)]))
    low = np.floor(corners.min(axis=0)).astype(int).clip(0, np.array(SIZE) - 1)
    high = np.ceil(corners.max(axis=0)).astype(int).clip(1, np.array(SIZE))
    u, v = np.arange(low[0], high[0], dtype=float), np.arange(low[1], high[1], dtype=float)
    px, py = eye.plane(sample_rays(eye, u, v, shot.samples), shot.height)
    paint, water = shot.swimmer(), pool[low[1] : high[1], low[0] : high[0], None]
    total = np.zeros((v.size, u.size, 3))
    for x, y, yaw in poses:
        c, s = np.cos(yaw), np.sin(yaw)
        there, colour = paint(c * (px - x) + s * (py - y), c * (py - y) - s * (px - x))
        total += np.where(there[..., None], colour, water).mean(axis=2)
    picture[low[1] : high[1], low[0] : high[0]] = total / len(poses)
    return picture


def developed(linear: Array, shot: Shot, t: float, rng: np.random.Generator) -> Picture:
    """Light (flicker, moving ripple), the sensor's gamma and noise; blue, green, red bytes."""
    v, u = np.ogrid[0 : SIZE[1], 0 : SIZE[0]]
    light = 1 + 0.02 * rng.standard_normal()
    light = light + 0.06 * np.sin(u / 23 + 4 * t) * np.sin(v / 31 - 3 * t)
    linear = cv2.GaussianBlur(linear, (0, 0), 0.45)
    lit = (linear * light[..., None].astype(np.float32)).clip(0, 1)
    grey = 255 * lit ** np.float32(1 / 2.2)
    noise = shot.noise * rng.standard_normal(grey.shape[:2], dtype=np.float32)
    return (grey[..., ::-1] + noise[..., None]).round().clip(0, 255).astype(np.uint8)


def frames(
    shot: Shot, t: Array, *, rng: np.random.Generator, hidden: tuple[float, float] = (0.0, 0.0)
) -> Iterator[Picture]:
    """One frame for each time t (its middle of exposure); while ``hidden`` an arm is in the way."""
    inside = (np.arange(5) - 2) / 5 * shot.exposure_s
    for time in t:
        at = swim(time + inside)
        picture = with_swimmer(shot, at)
        if hidden[0] <= time < hidden[1]:
            u, v = shot.eye.pixels(np.array([*at[2, :2], shot.height])).round().astype(int)
            picture[max(v - 14, 0) : v + 14, max(u - 60, 0) : u + 14] = (0.35, 0.2, 0.12)
        yield developed(picture, shot, float(time), rng)


def write_video(path: Path, pictures: Iterator[Picture], rate: float) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), rate, SIZE)
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path
