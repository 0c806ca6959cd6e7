"""Synchronisation of a video with the clock of a servo recording."""

from __future__ import annotations

import numpy as np

from sim2real.arrays import Array
from sim2real.hardware.tracker import Track
from sim2real.recording import Recording
from sim2real.velocity import body_velocity

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
    rates = np.stack([_rate(servo.t, angle, t) for angle in servo.position.T], axis=1)
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


def _rate(t: Array, angle: Array, grid: Array) -> Array:
    """Rate of a joint on a grid of times; missing angles are interpolated."""
    measured = np.isfinite(angle)
    return np.interp(grid, t, np.gradient(np.interp(t, t[measured], angle[measured]), t))


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
    """Body columns on the recording's clock; NaN where neighbouring frames are missing.

    ``start_s`` is the recording's time at the video's first frame.
    """
    t = servo.t - start_s
    gap = 1.5 * float(np.median(np.diff(track.t)))
    frame_t = track.t[track.seen]
    after = np.searchsorted(frame_t, t)
    before, after = (np.clip(k, 0, frame_t.size - 1) for k in (after - 1, after))
    inside = (t >= frame_t[0]) & (t <= frame_t[-1])
    valid = inside & (frame_t[after] - frame_t[before] <= gap)
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    return {
        name: np.where(valid, np.interp(t, frame_t, column), np.nan)
        for name, column in zip(names, track.pose[track.seen].T, strict=True)
    }
