"""``sim2real calibrate-camera``."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from sim2real.arrays import Picture
from sim2real.errors import InputError
from sim2real.hardware.camera import calibrate, charuco_board, stand, views, write_camera
from sim2real.hardware.tracker import open_video, read_picture
from sim2real.output import check_writable

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def run(options: argparse.Namespace) -> int:
    """Calibrate the lens, place the pool, write ``camera.toml``."""
    out = check_writable(options.out)
    board = board_of(options.board, options.dictionary)
    with tqdm(desc="calibrate-camera", unit="picture", disable=None) as bar:
        seen, size = views(_pictures(options.pictures), board, progress=lambda: bar.update(1))
    try:
        lens = calibrate(seen, size)
    except ValueError as error:
        where = options.pictures[0]
        raise InputError(where, "", str(error), "the board at many places and angles") from None
    length, width = numbers(options.pool, 2, "--pool")
    known = np.array([[0, 0], [length, 0], [length, width], [0, width]], dtype=np.float64)
    corners = np.array([numbers(pair, 2, "--corners") for pair in options.corners])
    try:
        plane = stand(lens, corners, known)
    except ValueError as error:
        raise InputError("calibrate-camera", "--corners", str(error), "corners in order") from None
    write_camera(out, lens, corners, known)
    print(f"{len(seen)} views of the board, reprojection error {lens.rms_px:.2f} px")
    x, y, z = plane.position
    within = np.sqrt(np.mean(np.sum((plane.pixels(known) - corners) ** 2, axis=1)))
    print(f"camera at {x:.2f}, {y:.2f}, {z:.2f} m; corners within {within:.2f} px")
    print(f"camera: {out}")
    return 0


def board_of(text: str, dictionary: str) -> Any:  # noqa: ANN401 - OpenCV's
    """OpenCV's board from ``ACROSS,DOWN,SQUARE,MARKER``.

    Raises:
        InputError: If that is none.
    """
    across, down, square, marker = numbers(text, 4, "--board")
    whole = across == int(across) and down == int(down)
    if not (whole and min(across, down) >= 3 and 0 < marker < square):
        raise InputError("calibrate-camera", "--board", text, "as 7,5,0.04,0.03: sides in m")
    return charuco_board((int(across), int(down)), square, marker, dictionary)


def numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    """Numbers with commas between.

    Raises:
        InputError: If there are not so many.
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not np.isfinite(values).all():
        raise InputError("calibrate-camera", option, repr(text), f"{count} numbers, commas between")
    return values


def _pictures(paths: list[Path]) -> Iterator[Picture]:
    for path in paths:
        if path.suffix.lower() in PICTURES:
            yield read_picture(path)
        else:
            frames, rate = open_video(path)
            for k, frame in enumerate(frames):
                if k % max(1, round(rate / 5)) == 0:
                    yield frame
