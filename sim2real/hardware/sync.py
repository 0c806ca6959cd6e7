"""When a video began on the servo recording's clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim2real.hardware.tracker import Track
from sim2real.recording import Recording
from sim2real.velocity import body_velocity

Array = NDArray[np.float64]

_GRID_S = 0.01
_LEAST_OVERLAP = 0.3


def flash(track: Track, *, least: float = 10.0) -> float:
    """Time in the video at which a lamp goes on: the largest jump of brightness.

    Args:
        track: The track.
        least: Grey levels of a jump that counts.

    Raises:
        ValueError: If there is none.
    """
    jump = np.diff(track.brightness)
    k = int(np.argmax(jump))
    others = np.delete(jump, k)
    if jump[k] < max(least, 6 * float(np.std(others))):
        raise ValueError(f"no flash: the brightest jump is {jump[k]:.1f} grey levels")
    return float(track.t[k] + track.t[k + 1]) / 2


def correlated(track: Track, servo: Recording, *, reach_s: float = 10.0) -> tuple[float, float]:
    """By how much the video is late, and how well the two agree there.

    A joint that bends turns the head the other way. The yaw rate is regressed on the rates of all
    joints at every lag; the lag at which they explain most of it, refined by a parabola, is it.

    Args:
        track: The track.
        servo: What the joints did meanwhile.
        reach_s: Largest lag to try.

    Returns:
        The recording's time at the video's first frame in s, and the share of the yaw rate's
        variance that is explained, 0 to 1.

    Raises:
        ValueError: If they hardly overlap, or nothing moves.
    """
    rates = _rates(servo)
    t = np.arange(servo.t[0], servo.t[-1], _GRID_S)
    yaw_t = np.arange(track.t[0], track.t[-1], _GRID_S)
    turning = np.interp(yaw_t, track.t, body_velocity(track.t, track.pose)[:, 2])
    on_grid = np.stack([np.interp(t, servo.t, rate) for rate in rates.T], axis=1)
    if not (on_grid.std() > 0 and turning.std() > 0):
        raise ValueError("nothing moves")
    lags = np.arange(-round(reach_s / _GRID_S), round(reach_s / _GRID_S) + 1)
    least = _LEAST_OVERLAP * min(t.size, yaw_t.size)
    shares = np.array([_explained(on_grid, turning, int(lag), least) for lag in lags])
    if not np.isfinite(shares).any():
        raise ValueError("the video and the recording hardly overlap")
    k = int(np.nanargmax(shares))
    off = 0.0
    if 0 < k < len(lags) - 1:
        a, b, c = shares[k - 1 : k + 2]
        if np.isfinite(a + b + c) and a - 2 * b + c < 0:
            off = 0.5 * (a - c) / (a - 2 * b + c)
    return float(servo.t[0] + (lags[k] + off) * _GRID_S), float(shares[k])


def _rates(servo: Recording) -> Array:
    out = []
    for angle in servo.position.T:
        known = np.isfinite(angle)
        filled = np.interp(servo.t, servo.t[known], angle[known])
        out.append(np.gradient(filled, servo.t))
    return np.stack(out, axis=1)


def _explained(rates: Array, turning: Array, lag: int, least: float) -> float:
    """Share of the variance explained where the video begins ``lag`` steps into the recording."""
    first, last = max(0, lag), min(len(rates), lag + turning.size)
    if last - first < least:
        return float("nan")
    design = np.column_stack([np.ones(last - first), rates[first:last]])
    seen = turning[first - lag : last - lag]
    normal = design.T @ design + 1e-9 * np.eye(design.shape[1])
    fit = design @ np.linalg.solve(normal, design.T @ seen)
    total = float(((seen - seen.mean()) ** 2).sum())
    return 1 - float(((seen - fit) ** 2).sum()) / max(total, 1e-12)


def joined(track: Track, servo: Recording, start_s: float) -> dict[str, Array]:
    """The body's columns on the recording's clock; NaN where the frames around are missing.

    Args:
        track: The track.
        servo: The recording to join.
        start_s: The recording's time at the video's first frame.
    """
    t = servo.t - start_s
    gap = 1.5 * float(np.median(np.diff(track.t)))
    seen = track.seen
    after = np.searchsorted(track.t[seen], t)
    known = track.t[seen]
    left = np.clip(after - 1, 0, known.size - 1)
    right = np.clip(after, 0, known.size - 1)
    there = (t >= known[0]) & (t <= known[-1]) & (known[right] - known[left] <= gap)
    names = ("body.x_m", "body.y_m", "body.yaw_rad")
    return {
        name: np.where(there, np.interp(t, known, column), np.nan)
        for name, column in zip(names, track.pose[seen].T, strict=True)
    }
