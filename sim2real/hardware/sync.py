"""Synchronisation of a video with the clock of a servo recording."""

from __future__ import annotations

import numpy as np

from sim2real.arrays import Array
from sim2real.hardware.tracker import Track
from sim2real.recording import Recording
from sim2real.velocity import body_velocity

_GRID_S = 0.01
_LEAST_OVERLAP = 0.3


def flash(track: Track, *, least: float = 10.0) -> float:
    """Time in the video at which a lamp is switched on: the largest step of brightness.

    Args:
        track: The track.
        least: Smallest step, in grey levels.

    Raises:
        ValueError: If there is none.
    """
    steps = np.diff(track.brightness)
    k = int(np.argmax(steps))
    other_steps = np.delete(steps, k)
    if steps[k] < max(least, 6 * float(np.std(other_steps))):
        raise ValueError(f"no flash: the largest step is {steps[k]:.1f} grey levels")
    return float(track.t[k] + track.t[k + 1]) / 2


def correlated(track: Track, servo: Recording, *, reach_s: float = 10.0) -> tuple[float, float]:
    """Lag of the video relative to the recording, and the explained share of variance.

    Bending of a joint rotates the head in the opposite direction. The yaw rate is regressed on the
    rates of all joints at every lag; the lag with the best fit is refined by a parabola.

    Args:
        track: The track.
        servo: The servo recording.
        reach_s: Largest lag.

    Returns:
        The recording's time at the video's first frame in s, and the share of the yaw rate's
        variance that is explained, 0 to 1.

    Raises:
        ValueError: If they hardly overlap, or there is no motion.
    """
    rates = _rates(servo)
    t = np.arange(servo.t[0], servo.t[-1], _GRID_S)
    yaw_t = np.arange(track.t[0], track.t[-1], _GRID_S)
    yaw_rate = np.interp(yaw_t, track.t, body_velocity(track.t, track.pose)[:, 2])
    on_grid = np.stack([np.interp(t, servo.t, rate) for rate in rates.T], axis=1)
    if not (on_grid.std() > 0 and yaw_rate.std() > 0):
        raise ValueError("nothing moves")
    lags = np.arange(-round(reach_s / _GRID_S), round(reach_s / _GRID_S) + 1)
    shortest = _LEAST_OVERLAP * min(t.size, yaw_t.size)
    shares = np.array([_explained(on_grid, yaw_rate, int(lag), shortest) for lag in lags])
    if not np.isfinite(shares).any():
        raise ValueError("the video and the recording hardly overlap")
    k = int(np.nanargmax(shares))
    offset = 0.0
    if 0 < k < len(lags) - 1:
        a, b, c = shares[k - 1 : k + 2]
        if np.isfinite(a + b + c) and a - 2 * b + c < 0:
            offset = 0.5 * (a - c) / (a - 2 * b + c)
    return float(servo.t[0] + (lags[k] + offset) * _GRID_S), float(shares[k])


def _rates(servo: Recording) -> Array:
    out = []
    for angle in servo.position.T:
        measured = np.isfinite(angle)
        filled = np.interp(servo.t, servo.t[measured], angle[measured])
        out.append(np.gradient(filled, servo.t))
    return np.stack(out, axis=1)


def _explained(rates: Array, yaw_rate: Array, lag: int, shortest: float) -> float:
    """Share of the variance explained if the video starts ``lag`` steps into the recording."""
    start, stop = max(0, lag), min(len(rates), lag + yaw_rate.size)
    if stop - start < shortest:
        return float("nan")
    design = np.column_stack([np.ones(stop - start), rates[start:stop]])
    observed = yaw_rate[start - lag : stop - lag]
    normal = design.T @ design + 1e-9 * np.eye(design.shape[1])
    fit = design @ np.linalg.solve(normal, design.T @ observed)
    total = float(((observed - observed.mean()) ** 2).sum())
    return 1 - float(((observed - fit) ** 2).sum()) / max(total, 1e-12)


def joined(track: Track, servo: Recording, start_s: float) -> dict[str, Array]:
    """Body columns on the recording's clock; NaN where neighbouring frames are missing.

    Args:
        track: The track.
        servo: The servo recording.
        start_s: The recording's time at the video's first frame.
    """
    t = servo.t - start_s
    gap = 1.5 * float(np.median(np.diff(track.t)))
    found = track.seen
    after = np.searchsorted(track.t[found], t)
    frame_t = track.t[found]
    before = np.clip(after - 1, 0, frame_t.size - 1)
    right = np.clip(after, 0, frame_t.size - 1)
    valid = (t >= frame_t[0]) & (t <= frame_t[-1]) & (frame_t[right] - frame_t[before] <= gap)
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    return {
        name: np.where(valid, np.interp(t, frame_t, column), np.nan)
        for name, column in zip(names, track.pose[found].T, strict=True)
    }
