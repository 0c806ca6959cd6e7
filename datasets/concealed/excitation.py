"""Set-points of 30 s: a short rest, then segments whose kinds, order and sizes are drawn anew."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Segment = Callable[[Array, float, np.random.Generator], Array]

DURATION_S = 30.0
LARGEST_RAD = 0.9
LARGEST_JUMP_RAD = 1.2
TAPER_S = 0.3


def small_triangle(t: Array, length: float, rng: np.random.Generator) -> Array:
    """Slow ramps of a few degrees; ``t`` (T,) counts from the segment's start, angles in rad."""
    return rng.uniform(0.04, 0.12) * _triangle(t / length * rng.integers(1, 3))


def large_triangle(t: Array, length: float, rng: np.random.Generator) -> Array:
    """Slow ramps through most of the range."""
    return rng.uniform(0.45, 0.85) * _triangle(t / length * rng.integers(1, 3))


def steps(t: Array, length: float, rng: np.random.Generator) -> Array:
    """Levels of all sizes, each held for 0.4 to 1.2 s."""
    changes = np.cumsum(rng.uniform(0.4, 1.2, size=int(length / 0.4) + 1))
    changes = changes[changes < length - 0.9]
    levels = [0.0]
    for _ in changes:
        size = 0.05 * (0.8 / 0.05) ** rng.random()
        level = size * rng.choice([-1.0, 1.0])
        near, far = levels[-1] - LARGEST_JUMP_RAD, levels[-1] + LARGEST_JUMP_RAD
        levels.append(float(np.clip(level, near, far)))
    held = np.array(levels[1:] + [0.0])[np.searchsorted(changes, t)]
    return np.where(t < length - 0.5, held, 0.0)


def chirp(t: Array, length: float, rng: np.random.Generator) -> Array:
    """A sine that rises from about 0.1 to about 2.5 Hz while its size falls by a half."""
    low, high = rng.uniform(0.08, 0.2), rng.uniform(2.0, 2.6)
    phase = 2 * np.pi * (low + (high - low) * t / (2 * length)) * t
    size = rng.uniform(0.2, 0.5) * (1 - 0.5 * t / length)
    return size * np.sin(phase) * _taper(t, length)


def multisine(t: Array, length: float, rng: np.random.Generator) -> Array:
    """Twelve sines of random phase from 0.1 to 2.5 Hz, the fast ones smaller."""
    frequency = np.sort(rng.uniform(0.1, 2.5, size=12))
    size = 1.0 / (0.4 + frequency)
    angle = 2 * np.pi * np.outer(t, frequency) + rng.uniform(0, 2 * np.pi, size=12)
    wave = (size * np.sin(angle)).sum(axis=1)
    return rng.uniform(0.35, 0.75) * wave / np.abs(wave).max() * _taper(t, length)


def holds(t: Array, length: float, rng: np.random.Generator) -> Array:
    """Two long holds on opposite sides, reached by smooth moves."""
    side = rng.choice([-1.0, 1.0])
    levels = np.array([0.0, side * rng.uniform(0.3, 0.8), -side * rng.uniform(0.3, 0.8), 0.0])
    move = rng.uniform(0.4, 0.8)
    starts = np.array([0.0, length / 2, length - move])
    wave = np.zeros_like(t)
    for start, change in zip(starts, np.diff(levels), strict=True):
        s = np.clip((t - start) / move, 0, 1)
        wave += change * s**3 * (10 - 15 * s + 6 * s**2)  # least jerk: Flash & Hogan (1985)
    return wave


PROGRAMMES: dict[str, dict[Segment, float]] = {  # segments and their shares of the time
    "a": {small_triangle: 4.5, large_triangle: 6.5, steps: 8.5, chirp: 6.5, holds: 3.5},
    "b": {multisine: 8.0, steps: 7.5, small_triangle: 4.0, large_triangle: 5.0, holds: 5.0},
    "c": {chirp: 7.0, multisine: 7.0, steps: 8.5, large_triangle: 4.5, holds: 3.0},
}


def signal(name: str, t: Array, rng: np.random.Generator, duration_s: float = DURATION_S) -> Array:
    """Set-points in rad at the times ``t`` (T,) in s of recording ``name``."""
    programme = list(PROGRAMMES[name].items())
    rest = rng.uniform(0.6, 1.0)
    shares = np.array([share for _, share in programme]) * rng.uniform(0.85, 1.15, len(programme))
    lengths = shares / shares.sum() * (duration_s - rest)
    command, start = np.zeros_like(t), rest
    for k in rng.permutation(len(programme)):
        segment, length = programme[k][0], float(lengths[k])
        inside = (t >= start) & (t < start + length)
        command[inside] = segment(t[inside] - start, length, rng)
        start += length
    return np.round(np.clip(command, -LARGEST_RAD, LARGEST_RAD), 6)


def _triangle(cycles: Array) -> Array:
    return 4 * np.abs((cycles + 0.75) % 1 - 0.5) - 1


def _taper(t: Array, length: float) -> Array:
    return np.clip(np.minimum(t, length - t) / TAPER_S, 0, 1)
