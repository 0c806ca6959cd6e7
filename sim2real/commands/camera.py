"""``sim2real track`` and ``sim2real calibrate-camera``: an overhead camera."""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from sim2real.arrays import Picture
from sim2real.commands.command import numbers
from sim2real.errors import InputError
from sim2real.hardware.camera import (
    calibrate,
    charuco_board,
    read_camera,
    stand,
    views,
    write_camera,
)
from sim2real.hardware.plots import track_figure
from sim2real.hardware.tracker import Track, correlated, joined, open_video, read_picture, track
from sim2real.output import beside, check_writable
from sim2real.recording import POSE, Recording, read_recording, write_recording
from sim2real.report.drawing import save_png
from sim2real.velocity import body_velocity

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_SURE = 0.3
"""Smallest share of the yaw rate's variance that the joints must explain at a valid lag."""
_CALIBRATE = "calibrate-camera"


def track_video(options: argparse.Namespace) -> int:
    """Track, join a servo recording if there is one, write recording and picture."""
    out = check_writable(options.out)
    camera = read_camera(options.camera)
    servo = read_recording(options.servo) if options.servo else None
    with tqdm(desc="track", unit="frame", disable=None) as bar:
        seen = track(options.video, camera, progress=lambda: bar.update(1))
    if servo is not None:
        recording = _with_servos(seen, servo, options)
    else:  # poses only, one row per frame, without joint angles
        nothing, joints = np.full((seen.t.size, len(options.joints)), np.nan), tuple(options.joints)
        columns = dict(zip(POSE, seen.pose.T, strict=True))
        recording = Recording(
            "", "pool", joints, seen.t, nothing, nothing, medium="water", columns=columns
        )
    enough = seen.seen.sum() >= 5
    speed = body_velocity(seen.t, seen.pose) if enough else np.zeros((1, 3))
    source = recording.source or f"sim2real track {options.video}"
    write_recording(replace(recording, name=out.stem, source=source), out)
    picture = beside(out, f"{out.stem}.png")
    save_png(track_figure(seen, camera.corners_m), picture)
    surge, yaw = speed[:, 0].mean(), np.abs(speed[:, 2]).max()
    print(f"seen in {int(seen.seen.sum())} of {seen.t.size} frames")
    print(f"mean surge {surge:.3f} m/s, largest yaw rate {yaw:.2f} rad/s")
    print(f"recording: {out}\npicture: {picture}")
    return 0


def _with_servos(seen: Track, servo: Recording, options: argparse.Namespace) -> Recording:
    """The servo recording with the body's columns, on a common clock."""
    try:
        if options.sync == "correlate":
            start, share = correlated(seen, servo)
            print(f"video begins at {start:.3f} s; joints explain {100 * share:.0f} % of the yaw")
            if share < _SURE:
                raise ValueError(f"the joints explain {100 * share:.0f} % of the yaw rate")
        else:
            start = -float(options.sync)
    except ValueError as error:
        expected = "correlate, or the video's time in s at the recording's 0"
        found = f"{options.sync} ({error})"
        raise InputError("track", "--sync", found, expected) from None
    columns = {**servo.columns, **joined(seen, servo, start)}
    if not np.isfinite(columns[POSE[0]]).any():
        raise InputError(options.video, "", "no frame of the recording's time", "one that overlaps")
    return replace(servo, kind="pool", loads={}, medium="water", columns=columns)


def calibrate_camera(options: argparse.Namespace) -> int:
    """Calibrate the lens, place the pool, write ``camera.toml``."""
    out = check_writable(options.out)
    board = board_of(options.board, options.dictionary)
    with tqdm(desc=_CALIBRATE, unit="picture", disable=None) as bar:
        seen, size = views(_pictures(options.pictures), board, progress=lambda: bar.update(1))
    try:
        lens = calibrate(seen, size)
    except ValueError as error:
        where = options.pictures[0]
        raise InputError(where, "", str(error), "the board at many places and angles") from None
    length, width = _numbers(options.pool, 2, "--pool")
    known = np.array([[0, 0], [length, 0], [length, width], [0, width]], dtype=np.float64)
    corners = np.array([_numbers(pair, 2, "--corners") for pair in options.corners])
    try:
        plane = stand(lens, corners, known)
    except ValueError as error:
        raise InputError(_CALIBRATE, "--corners", str(error), "corners in order") from None
    write_camera(out, lens, corners, known)
    print(f"{len(seen)} views of the board, reprojection error {lens.rms_px:.2f} px")
    x, y, z = plane.position
    within = np.sqrt(np.mean(np.sum((plane.pixels(known) - corners) ** 2, axis=1)))
    print(f"camera at {x:.2f}, {y:.2f}, {z:.2f} m; corners within {within:.2f} px")
    print(f"camera: {out}")
    return 0


def board_of(text: str, dictionary: str) -> Any:  # noqa: ANN401 - OpenCV's
    """OpenCV's board from ``ACROSS,DOWN,SQUARE,MARKER``."""
    across, down, square, marker = _numbers(text, 4, "--board")
    whole = across == int(across) and down == int(down)
    if not (whole and min(across, down) >= 3 and 0 < marker < square):
        raise InputError(_CALIBRATE, "--board", text, "as 7,5,0.04,0.03: sides in m")
    return charuco_board((int(across), int(down)), square, marker, dictionary)


def _numbers(text: str, count: int, option: str) -> list[float]:
    return numbers(option, text, float, f"{count} numbers, commas between", count=count)


def _pictures(paths: list[Path]) -> Iterator[Picture]:
    for path in paths:
        if path.suffix.lower() in PICTURES:
            yield read_picture(path)
        else:
            frames, rate = open_video(path)
            for k, frame in enumerate(frames):
                if k % max(1, round(rate / 5)) == 0:
                    yield frame
