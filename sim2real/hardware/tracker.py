"""Tracking of the body's pose in an overhead video, and its synchronisation with the servos.

The position of the marker is predicted from its motion; if it is not found there, it is searched
nearby, then in the whole frame. Frames in which it is not found are missing. Robots that cannot
carry a marker have a coloured patch.
"""

import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim2real.arrays import Array, Mask, Picture
from sim2real.errors import InputError
from sim2real.hardware.camera import Blob, Camera, Marker, Plane
from sim2real.hardware.registration import Finder, Sighting
from sim2real.recording import POSE, Recording
from sim2real.structured import LARGEST_STREAM_BYTES, check_size
from sim2real.velocity import body_velocity

LIKENESS = 0.85
"""Smallest correlation with the print of a valid sighting."""
NEARBY_M = 0.25
EVERYWHERE = 10
"""Interval in frames between searches of the whole frame while the marker is lost."""
_STEADY = 0.7
_TURN = np.deg2rad(25)
"""Largest change of yaw between frames; sightings beyond it are rejected."""


@dataclass(frozen=True)
class Track:
    """Track of the body in a video.

    ``t`` are times in s since the first frame (T,), ``pose`` x, y in m and unwrapped heading in rad
    (T, 3), NaN if not found.
    """

    t: Array
    pose: Array

    @property
    def seen(self) -> Mask:
        """Mask of frames in which the body was found, shape (T,)."""
        return np.asarray(np.isfinite(self.pose[:, 0]))


class MarkerTracker:
    """Follows one marker from frame to frame."""

    def __init__(self, plane: Plane, marker: Marker) -> None:
        self._finder = Finder(plane, marker)
        self._last: Array | None = None
        self._rate = np.zeros(3)
        self._blur: float | None = None
        self._lost = 0

    def see(self, frame: Picture) -> Array | None:
        """Pose of the marker (3,) in the next grey frame, or None."""
        sighting = self._predicted(frame) or self._searched(frame)
        if sighting is None:
            self._lost += 1
            return None
        pose = sighting.pose
        if self._last is not None:
            pose = pose.copy()
            pose[2] += 2 * np.pi * np.round((self._last[2] - pose[2]) / (2 * np.pi))
            step = (pose - self._last) / (self._lost + 1)
            self._rate = step if self._lost else _STEADY * step + (1 - _STEADY) * self._rate
        self._last, self._lost = pose, 0
        self._blur = sighting.blur_m
        return pose

    def _predicted(self, frame: Picture) -> Sighting | None:
        if self._last is None or self._lost > 3:
            return None
        guess = self._last + (self._lost + 1) * self._rate
        sighting = self._finder.register(frame, guess, self._blur)
        if sighting is None or sighting.likeness < LIKENESS:
            return None
        turned = (sighting.pose[2] - self._last[2] + np.pi) % (2 * np.pi) - np.pi
        return sighting if abs(turned) < _TURN * (self._lost + 1) else None

    def _searched(self, frame: Picture) -> Sighting | None:
        windows = []
        if self._last is not None and self._lost < 3 * EVERYWHERE:
            reach = NEARBY_M * (1 + self._lost / 10)
            around = self._last[:2] + reach * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]])
            pixels = self._finder.plane.pixels(around)
            low = np.clip(np.floor(pixels.min(axis=0)), 0, None).astype(int)
            high = np.clip(np.ceil(pixels.max(axis=0)) + 1, 1, frame.shape[::-1]).astype(int)
            windows.append((*low.tolist(), *high.tolist()))
        if self._lost % EVERYWHERE == (0 if self._last is None else EVERYWHERE - 1):
            windows.append((0, 0, frame.shape[1], frame.shape[0]))
        for window in windows:
            poses = self._finder.search(frame, window)
            found = [self._finder.register(frame, pose, self._blur) for pose in poses]
            seen = [sighting for sighting in found if sighting is not None]
            best = max(seen, key=lambda sighting: sighting.likeness, default=None)
            if best is not None and best.likeness >= LIKENESS:
                return best
        return None


def find_blob(picture: Picture, plane: Plane, blob: Blob, *, fewest_px: int = 6) -> Array | None:
    """x, y in m and direction of the long axis (modulo pi) of the largest patch, shape (3,).

    The pose is the mean and the principal axis of its pixels in world coordinates. None if there
    is no such patch in the picture (blue, green, red), or it has fewer than ``fewest_px`` pixels.
    """
    import cv2

    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    low, high = blob.low_hsv, blob.high_hsv
    mask = cv2.inRange(hsv, low, high)
    if low[0] > high[0]:
        red = cv2.inRange(hsv, low, np.array([180.0, *high[1:]]))
        mask = cv2.bitwise_or(red, cv2.inRange(hsv, np.array([0.0, *low[1:]]), high))
    _, label, stats, _ = cv2.connectedComponentsWithStats(mask)
    areas = stats[1:, cv2.CC_STAT_AREA]
    if max(areas, default=0) < fewest_px:
        return None
    rows, columns = np.nonzero(label == 1 + int(np.argmax(areas)))
    spots = plane.raised(blob.height_m).world(np.column_stack([columns, rows]))
    middle = spots.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((spots - middle).T))
    return np.array([*middle, np.arctan2(axes[1, -1], axes[0, -1])])


def ahead(poses: Array) -> Array:
    """Poses (T, 3) of blobs with unwrapped headings; NaN if missing. A robot swims head first."""
    out = np.array(poses)
    found = np.flatnonzero(np.isfinite(out[:, 2]))
    if found.size < 2:
        return out
    out[found, 2] = np.unwrap(out[found, 2], period=np.pi)
    steps = np.diff(out[found, :2], axis=0)
    heading = (out[found, 2][1:] + out[found, 2][:-1]) / 2
    forward = steps[:, 0] * np.cos(heading) + steps[:, 1] * np.sin(heading)
    if forward.sum() < 0:
        out[found, 2] += np.pi
    return out


def track(
    video: str | os.PathLike[str], camera: Camera, *, progress: Callable[[], None] = lambda: None
) -> Track:
    """Track the body in a video; ``InputError`` if that fails. ``progress`` after each frame."""
    import cv2

    frames, rate = open_video(video, camera)
    found: list[Array] = []
    tracker = MarkerTracker(camera.plane, camera.marker) if camera.marker else None
    for picture in frames:
        grey: Picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)  # type: ignore[assignment]
        pose = tracker.see(grey) if tracker else None
        if tracker is None and camera.blob is not None:
            pose = find_blob(picture, camera.plane, camera.blob)
        found.append(np.full(3, np.nan) if pose is None else pose)
        progress()
    poses = np.array(found).reshape(-1, 3)
    if not np.isfinite(poses).any():
        target = "marker" if camera.marker else "blob"
        raise InputError(video, "", f"no {target} in any of {len(poses)} frames", f"the {target}")
    poses = camera.marker.body(poses) if camera.marker else ahead(poses)
    return Track(np.arange(len(poses)) / rate, poses)


def open_video(
    video: str | os.PathLike[str], camera: Camera | None = None
) -> tuple[Iterator[Picture], float]:
    """Frames of a video and their rate in 1/s; ``InputError`` if it cannot be used."""
    import cv2

    source = cv2.VideoCapture(_checked(video))
    if not source.isOpened():
        raise InputError(video, "", "no video that can be read", "an AVI, MP4 or MKV file")
    rate = float(source.get(cv2.CAP_PROP_FPS))
    size = tuple(int(source.get(p)) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    if camera is not None and size != camera.plane.lens.size_px:
        expected = "x".join(map(str, camera.plane.lens.size_px)) + ", as the camera's"
        raise InputError(video, "", f"frames of {size[0]}x{size[1]}", expected)
    if not rate > 0:
        raise InputError(video, "", "no frame rate", "a video with a frame rate")

    def frames() -> Iterator[Picture]:
        try:
            while (taken := source.read())[0]:
                yield taken[1]  # type: ignore[misc]
        finally:
            source.release()

    return frames(), rate


def _checked(path: str | os.PathLike[str]) -> str:
    """The path, unless it is a pipe or a device; OpenCV finds out whether there is such a file."""
    if Path(path).exists():
        check_size(Path(path), LARGEST_STREAM_BYTES)
    return os.fspath(path)


def read_picture(path: str | os.PathLike[str]) -> Picture:
    """One picture, blue, green, red, shape (V, U, 3). ``InputError`` if it can't be read."""
    import cv2

    picture = cv2.imread(_checked(path))
    if picture is None:
        raise InputError(path, "", "no picture that can be read", "a PNG or JPEG")
    return picture  # type: ignore[return-value]


_GRID_S = 0.01
_LEAST_OVERLAP = 0.3


def correlated(track: Track, servo: Recording, *, reach_s: float = 10.0) -> tuple[float, float]:
    """Lag of the video relative to the recording, and the explained share of variance.

    Bending of a joint rotates the head in the opposite direction. The yaw rate is regressed on the
    rates of all joints at every lag up to ``reach_s``; the lag with the best fit is refined by a
    parabola. The lag is the recording's time at the video's first frame in s. ``ValueError`` if
    they hardly overlap, or there is no motion.
    """
    t = np.arange(servo.t[0], servo.t[-1], _GRID_S)
    yaw_t = np.arange(track.t[0], track.t[-1], _GRID_S)
    yaw_rate = np.interp(yaw_t, track.t, body_velocity(track.t, track.pose)[:, 2])
    columns = []
    for angle in servo.position.T:
        there = np.isfinite(angle)  # missing angles are interpolated
        whole = np.interp(servo.t, servo.t[there], angle[there])
        columns.append(np.interp(t, servo.t, np.gradient(whole, servo.t)))
    rates = np.stack(columns, axis=1)
    if not (rates.std() > 0 and yaw_rate.std() > 0):
        raise ValueError("nothing moves")
    lags = np.arange(-round(reach_s / _GRID_S), round(reach_s / _GRID_S) + 1)
    shortest = _LEAST_OVERLAP * min(t.size, yaw_t.size)
    shares = np.array([_explained(rates, yaw_rate, int(lag), shortest) for lag in lags])
    if not np.isfinite(shares).any():
        raise ValueError("the video and the recording hardly overlap")
    k = int(np.nanargmax(shares))
    offset = 0.0
    if 0 < k < len(lags) - 1:
        a, b, c = shares[k - 1 : k + 2]
        if a - 2 * b + c < 0:  # False with NaN
            offset = 0.5 * (a - c) / (a - 2 * b + c)
    return float(servo.t[0] + (lags[k] + offset) * _GRID_S), float(shares[k])


def _explained(rates: Array, yaw_rate: Array, lag: int, shortest: float) -> float:
    """Share of the variance explained if the video starts ``lag`` steps into the recording."""
    start, stop = max(0, lag), min(len(rates), lag + yaw_rate.size)
    if stop - start < shortest:
        return float("nan")
    design = np.column_stack([np.ones(stop - start), rates[start:stop]])
    observed = yaw_rate[start - lag : stop - lag]
    normal = design.T @ design + 1e-9 * np.eye(design.shape[1])
    missed = observed - design @ np.linalg.solve(normal, design.T @ observed)
    return 1 - float(missed @ missed) / max(float(observed.var() * observed.size), 1e-12)


def joined(track: Track, servo: Recording, start_s: float) -> dict[str, Array]:
    """Body columns on the recording's clock, missing beside a frame without the body.

    The video's first frame is at ``start_s``.
    """
    t = servo.t - start_s
    poses = zip(POSE, track.pose.T, strict=True)
    return {name: np.interp(t, track.t, x, math.nan, math.nan) for name, x in poses}
