"""Frames a second of the tracker, and its error, on a rendered video at 640 x 480.

python benchmarks/track_speed.py [--frames 150]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hardware"))
import overhead  # noqa: E402

from sim2real.hardware.camera_file import Camera  # noqa: E402
from sim2real.hardware.marker import Marker  # noqa: E402
from sim2real.hardware.plane import (
    Lens,  # noqa: E402
    stand,  # noqa: E402
)
from sim2real.hardware.tracker import track  # noqa: E402

RATE = 30.0
CORNERS = np.array([[0.0, 0.0], [3.6, 0.0], [3.6, 3.6], [0.0, 3.6]])


def main() -> None:
    """Render, track, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=150)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    shot, t = overhead.Shot(), np.arange(options.frames) / RATE
    (fx, fy), (cx, cy) = shot.eye.focal, shot.eye.centre
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    corners = shot.eye.pixels(np.column_stack([CORNERS, np.zeros(4)]))
    plane = stand(Lens(overhead.SIZE, matrix, np.array(shot.eye.lens)), corners, CORNERS)
    camera = Camera(plane, CORNERS, Marker("4x4_50", 3, 0.06, 0.05))
    with tempfile.TemporaryDirectory() as folder:
        pictures = overhead.frames(shot, t, rng=np.random.default_rng(0))
        video = overhead.write_video(Path(folder) / "swim.avi", pictures, RATE, "MJPG")
        start, used = time.perf_counter(), time.process_time()
        found = track(video, camera)
        spent, used = time.perf_counter() - start, time.process_time() - used
    off = found.pose - overhead.swim(t)
    turned = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    print(f"{t.size / spent:.0f} frames/s ({t.size / used:.0f} a second of one core's time)")
    print(f"seen in {100 * found.seen.mean():.0f} %")
    print(f"{1e3 * np.sqrt(np.nanmean((off[:, :2] ** 2).sum(axis=1))):.2f} mm RMS")
    print(f"{np.rad2deg(np.sqrt(np.nanmean(turned**2))):.2f} degrees RMS")


if __name__ == "__main__":
    main()
