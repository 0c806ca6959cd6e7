"""From the true angle to what the recording says: errors of the sensor, noise, rounding, gaps."""

from __future__ import annotations

import numpy as np
from bench import Sensor
from numpy.typing import NDArray
from plant import Record

Array = NDArray[np.float64]


def seen_angle(p: Record, errors: dict[str, float], angle: Array) -> Array:
    """Angle in rad as the sensor passes it on without noise, shape (T,).

    Args:
        p: The joint's plant parameters; its gear has a small transmission error.
        errors: ``offset_rad``, ``gain`` and the three of a bad potentiometer, where there are any.
        angle: True angle, shape (T,).
    """
    seen = angle + p["tooth_error_rad"] * np.sin(p["teeth_per_rad"] * angle + p["tooth_phase"])
    seen = errors.get("gain", 1.0) * seen + errors.get("offset_rad", 0.0)
    seen = seen + errors.get("bend_per_rad", 0.0) * angle**2
    period = errors.get("bump_period_rad", 1.0)
    bump = np.sin(2 * np.pi * angle / period + errors.get("bump_phase_rad", 0.0))
    return np.asarray(seen + errors.get("bump_rad", 0.0) * bump)


def noise(sensor: Sensor, t: Array, rng: np.random.Generator) -> Array:
    """White noise and an Ornstein-Uhlenbeck process in its steady state, rad, shape (T,)."""
    fade = np.exp(-np.diff(t) / sensor.wander_s)
    drawn = rng.normal(size=t.size)
    wander = np.empty(t.size)
    wander[0] = drawn[0]
    for k, (keep, fresh) in enumerate(zip(fade, drawn[1:], strict=True)):
        wander[k + 1] = keep * wander[k] + np.sqrt(1 - keep**2) * fresh
    return sensor.wander_rad * wander + rng.normal(0.0, sensor.white_rad, size=t.size)


def quantize(angle: Array, step_rad: float) -> Array:
    """Rounded to whole steps."""
    return np.round(angle / step_rad) * step_rad


def stick(angle: Array, t: Array, windows: list[tuple[float, float]]) -> Array:
    """Inside each window the last reading before it again and again."""
    stuck = angle.copy()
    for start, stop in windows:
        inside = (t >= start) & (t < stop)
        if inside.any():
            stuck[inside] = stuck[max(int(np.argmax(inside)) - 1, 0)]
    return stuck
