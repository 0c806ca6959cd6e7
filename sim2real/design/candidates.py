"""Random commands of several families, all within the limits of a joint.

Sums of sines with random phases, periodic Fourier series (Swevers et al., IEEE Trans. Robot. Autom.
13 (1997) 730-740), chirps, steps and holds, binary signals and splines.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits, within

Family = Callable[[np.random.Generator, Array, float], Array]
"""A function of the generator, the times (T,) in s from 0 and the highest frequency in Hz, which
returns a signal of about -1 to 1, shape (T,)."""

HIGHEST_HZ = 8.0
"""Highest frequency of the commands; natural frequencies of servos are mostly below it."""
SLOWEST_HZ = 0.1


def multisine(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """Up to 24 sines of random phases, frequencies and sizes."""
    count = int(rng.integers(3, 25))
    low, high = np.sort(_log_uniform(rng, SLOWEST_HZ, highest_hz, 2))
    frequency = _log_uniform(rng, low, high, count)
    size = frequency ** -rng.uniform(0.0, 1.5)
    phase = 2 * np.pi * (np.outer(frequency, t) + rng.random((count, 1)))
    return _scaled(size @ np.sin(phase), rng)


def fourier(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """A periodic Fourier series with random coefficients, of several periods."""
    base = float(_log_uniform(rng, SLOWEST_HZ, 1.0, 1)[0])
    count = min(int(rng.integers(3, 13)), max(int(highest_hz / base), 1))
    harmonic = np.arange(1, count + 1)
    angle = 2 * np.pi * base * np.outer(harmonic, t)
    a, b = rng.standard_normal((2, count)) / harmonic ** rng.uniform(0.0, 1.0)
    return _scaled(a @ np.sin(angle) + b @ np.cos(angle), rng)


def chirp(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """A sine whose frequency sweeps between two random ones, once or several times."""
    ends = _log_uniform(rng, SLOWEST_HZ, highest_hz, 2)
    sweeps = rng.integers(1, 7)
    share = np.abs((t / t[-1] * sweeps + 1) % 2 - 1)
    frequency = ends[0] * (ends[1] / ends[0]) ** share
    phase = 2 * np.pi * (np.cumsum(frequency) * (t[1] - t[0]) + rng.random())
    return np.asarray(np.sin(phase) * (frequency / frequency.min()) ** -rng.uniform(0.0, 0.7))


def holds(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """Random levels, each held for a random time."""
    shortest, longest = np.sort(_log_uniform(rng, 0.5 / highest_hz, 1.5, 2))
    levels, place = _intervals(rng, t, shortest, longest)
    size = rng.uniform(0.2, 1.0, levels) ** rng.choice([0.3, 1.0])
    side = rng.choice([-1.0, 1.0], levels)
    return np.asarray((side * size)[place])


def binary(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """Alternates between two levels after random times."""
    shortest, longest = np.sort(_log_uniform(rng, 0.5 / highest_hz, 1.0, 2))
    levels, place = _intervals(rng, t, shortest, longest)
    size = rng.choice([1.0, rng.uniform(0.3, 1.0)], levels)
    return np.asarray((np.where(np.arange(levels) % 2, -1.0, 1.0) * size)[place])


def spline(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """A cubic spline through random knots."""
    spacing = float(_log_uniform(rng, 0.5 / highest_hz, 0.6, 1)[0])
    knots = np.arange(0.0, t[-1] + 4 * spacing, spacing)
    size = rng.uniform(-1.0, 1.0, knots.size)
    return _scaled(make_interp_spline(knots, np.sign(size) * np.abs(size) ** 0.5)(t), rng)


FAMILIES: tuple[Family, ...] = (multisine, fourier, chirp, holds, binary, spline)


def draw(
    rng: np.random.Generator,
    count: int,
    limits: CommandLimits,
    seconds: float,
    *,
    mixed: float = 0.4,
    highest_hz: float = HIGHEST_HZ,
) -> Array:
    """Random commands within the limits, at rest at both ends, rad, shape (N, T).

    The families take turns; the share ``mixed`` consists of parts of several.
    """
    t = limits.times(seconds)
    size = limits.reach_rad * rng.uniform(0.4, 1.1, (count, 1))
    shapes = [_shape(rng, t, k, mixed, highest_hz) for k in range(count)]
    return within(limits.rest_rad + size * np.array(shapes), limits)


def _shape(rng: np.random.Generator, t: Array, k: int, mixed: float, highest_hz: float) -> Array:
    if rng.random() >= mixed:
        return FAMILIES[k % len(FAMILIES)](rng, t, highest_hz)
    parts = np.array_split(np.arange(t.size), int(rng.integers(2, 7)))
    out = np.empty(t.size)
    for part in parts:
        family = FAMILIES[int(rng.integers(len(FAMILIES)))]
        out[part] = family(rng, t[part] - t[part[0]], highest_hz)
    return out


def _intervals(
    rng: np.random.Generator, t: Array, shortest: float, longest: float
) -> tuple[int, np.ndarray]:
    """Number of intervals of random lengths, and the interval of each time (T,)."""
    ends = np.cumsum(rng.uniform(shortest, longest, int(t[-1] / shortest) + 2))
    place = np.searchsorted(ends, t, side="right")
    return int(place[-1]) + 1, place


def _log_uniform(rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    return np.asarray(low * (high / low) ** rng.random(count))


def _scaled(wave: Array, rng: np.random.Generator) -> Array:
    """A signal scaled to 1 at its peak, or beyond, where the range then clips it."""
    return np.asarray(wave / np.abs(wave).max() * rng.choice([1.0, 1.5, 3.0]))
