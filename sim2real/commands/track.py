"""``sim2real track``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from sim2real.errors import InputError
from sim2real.hardware.camera import read_camera
from sim2real.hardware.plots import track_figure
from sim2real.hardware.sync import correlated, flash, joined
from sim2real.hardware.tracker import Track, track
from sim2real.output import beside, check_writable
from sim2real.recording import Recording, read_recording, write_recording
from sim2real.report.drawing import save_png
from sim2real.velocity import body_velocity

_SURE = 0.3
"""Smallest share of the yaw rate's variance that the joints must explain at a valid lag."""


def run(options: argparse.Namespace) -> int:
    """Track, join a servo recording if there is one, write recording and picture."""
    out = check_writable(options.out)
    camera = read_camera(options.camera)
    servo = read_recording(options.servo) if options.servo else None
    with tqdm(desc="track", unit="frame", disable=None) as bar:
        body_track = track(options.video, camera, progress=lambda: bar.update(1))
    recording = (
        poses_only(body_track, out.stem, options.joints)
        if servo is None
        else with_servos(body_track, servo, options)
    )
    speed = (
        body_velocity(body_track.t, body_track.pose)
        if body_track.seen.sum() >= 5
        else np.zeros((1, 3))
    )
    source = f"sim2real track {options.video}"
    write_recording(replace(recording, name=out.stem, source=recording.source or source), out)
    picture = beside(out, f"{out.stem}.png")
    save_png(track_figure(body_track, camera.corners_m), picture)
    print(f"seen in {int(body_track.seen.sum())} of {body_track.t.size} frames")
    print(
        f"mean surge {speed[:, 0].mean():.3f} m/s, largest yaw rate "
        f"{np.abs(speed[:, 2]).max():.2f} rad/s"
    )
    print(f"recording: {out}\npicture: {picture}")
    return 0


def poses_only(body_track: Track, name: str, joints: Sequence[str]) -> Recording:
    """A pool recording of poses, one row per frame, without joint angles."""
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    nothing = np.full((body_track.t.size, len(joints)), np.nan)
    return Recording(
        name=name,
        kind="pool",
        joints=tuple(joints),
        t=body_track.t,
        command=nothing,
        position=nothing,
        medium="water",
        columns=dict(zip(names, body_track.pose.T, strict=True)),
    )


def with_servos(body_track: Track, servo: Recording, options: argparse.Namespace) -> Recording:
    """The servo recording with the body's columns, on a common clock.

    Raises:
        InputError: If the clocks cannot be synchronised.
    """
    try:
        if options.sync == "correlate":
            start, share = correlated(body_track, servo)
            print(f"video begins at {start:.3f} s; joints explain {100 * share:.0f} % of the yaw")
            if share < _SURE:
                raise ValueError(f"the joints explain {100 * share:.0f} % of the yaw rate")
        elif options.sync == "flash":
            start = float(servo.t[0]) - flash(body_track)
        else:
            start = -float(options.sync)
    except ValueError as error:
        expected = "correlate, flash, or the video's time in s at the recording's 0"
        found = f"{options.sync} ({error})"
        raise InputError("track", "--sync", found, expected) from None
    columns = {**servo.columns, **joined(body_track, servo, start)}
    if not np.isfinite(columns["body.x_m"]).any():
        raise InputError(options.video, "", "no frame of the recording's time", "one that overlaps")
    return replace(servo, kind="pool", loads={}, medium="water", columns=columns)
