"""Search for the best command: random ones, of which the best are varied."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits

HIGHEST_HZ = 8.0
"""Highest frequency of the commands; natural frequencies of servos are mostly below it."""
SLOWEST_HZ = 0.1
_ELITE = 8
"""Number of the best commands that are varied."""


def multisine(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """Up to 24 sines of random phases, frequencies and sizes."""
    count = int(rng.integers(3, 25))
    low, high = np.sort(_log_uniform(rng, SLOWEST_HZ, highest_hz, 2))
    frequency = _log_uniform(rng, low, high, count)
    size = frequency ** -rng.uniform(0.0, 1.5)
    phase = 2 * np.pi * (np.outer(frequency, t) + rng.random((count, 1)))
    return _scaled(size @ np.sin(phase), rng)


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
    ends = np.cumsum(rng.uniform(shortest, longest, int(t[-1] / shortest) + 2))
    size = rng.uniform(0.2, 1.0, ends.size) ** rng.choice([0.3, 1.0])
    side = rng.choice([-1.0, 1.0], ends.size)
    return np.asarray((side * size)[np.searchsorted(ends, t, side="right")])


def spline(rng: np.random.Generator, t: Array, highest_hz: float) -> Array:
    """A cubic spline through random knots."""
    spacing = float(_log_uniform(rng, 0.5 / highest_hz, 0.6, 1)[0])
    knots = np.arange(0.0, t[-1] + 4 * spacing, spacing)
    size = rng.uniform(-1.0, 1.0, knots.size)
    return _scaled(make_interp_spline(knots, np.sign(size) * np.abs(size) ** 0.5)(t), rng)


FAMILIES = (multisine, chirp, holds, spline)
"""Signals of about -1 to 1, (T,), by a generator, times (T,) from 0 and the highest frequency."""


def draw(rng: np.random.Generator, count: int, limits: CommandLimits, seconds: float) -> Array:
    """Random commands within the limits, rad, shape (N, T)."""
    t = limits.times(seconds)
    size = limits.reach_rad * rng.uniform(0.4, 1.1, (count, 1))
    families = rng.integers(len(FAMILIES), size=count)
    shapes = [FAMILIES[k](rng, t, HIGHEST_HZ) for k in families]
    return limits.within(limits.rest_rad + size * np.array(shapes))


def _log_uniform(rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    return np.asarray(low * (high / low) ** rng.random(count))


def _scaled(wave: Array, rng: np.random.Generator) -> Array:
    """A signal scaled to 1 at its peak, or beyond, where the range then clips it."""
    return np.asarray(wave / np.abs(wave).max() * rng.choice([1.0, 1.5, 3.0]))


Limits = Any
"""``CommandLimits`` of one joint, or limits of several with the same attributes."""
Draw = Callable[[np.random.Generator, int, Limits, float], Array]
"""As ``draw``, of several joints (N, T, J)."""


@dataclass(frozen=True)
class SearchResult:
    """Result of a search."""

    command: Array  # the best command in rad, shape (T,), or (T, J) of several joints
    score: float
    evaluated: int  # number of commands that were evaluated


def part(progress: Callable[[float], None], k: int, parts: int) -> Callable[[float], None]:
    """The progress of the k-th of equal parts."""
    return lambda share: progress((k + share) / parts)


def best(
    objective: Callable[[Array], Array],
    limits: Limits,
    seconds: float,
    *,
    rng: np.random.Generator,
    draw: Draw = draw,
    drawn: int = 128,
    rounds: int = 64,
    batch: int = 8,
    progress: Callable[[float], None] = lambda share: None,
) -> SearchResult:
    """The command with the highest score among random ones and variations of the best.

    The ``objective`` goes from commands (N, T), or (N, T, J) of several joints, in rad to their
    scores (N,); -inf excludes a command. ``drawn`` random commands are scored, ``batch`` at a time,
    and the best varied in ``rounds`` of that many.
    """
    pool = draw(rng, drawn, limits, seconds)
    batches = np.array_split(pool, max(1, -(-drawn // batch)))
    total, scores = len(batches) + rounds, []
    for k, some in enumerate(batches):
        scores.append(objective(some))
        progress((k + 1) / total)
    score = np.concatenate(scores)
    for k in range(rounds):
        order = np.argsort(-score)[:_ELITE]
        pool, score = pool[order], score[order]
        parents = np.minimum(rng.geometric(0.35, batch) - 1, len(pool) - 1)
        varied = [_varied(pool[p], pool, limits, rng, draw) for p in parents]
        kept = limits.within(np.array(varied))
        pool, score = np.concatenate([pool, kept]), np.append(score, objective(kept))
        progress((len(batches) + 1 + k) / total)
    first = int(np.argmax(score))
    return SearchResult(pool[first], float(score[first]), drawn + rounds * batch)


def _varied(
    command: Array, elite: Array, limits: Limits, rng: np.random.Generator, draw: Draw
) -> Array:
    """One of the best commands (T, ...), of which a part of a thirtieth to a half is changed."""
    kind, out, T = int(rng.integers(4)), command.copy(), len(command)
    length = int(T * np.exp(rng.uniform(np.log(0.03), np.log(0.5))))
    begin = int(rng.integers(0, T - length))
    part = slice(begin, begin + length)
    if kind == 0:  # by a part of another command, from anywhere in it
        source = int(rng.integers(0, T - length))
        out[part] = elite[int(rng.integers(len(elite)))][source : source + length]
    elif kind == 1:  # by a new random command
        seconds = length * limits.period_s + 4 * limits.rest_s
        new = draw(rng, 1, limits, seconds)[0][round(2 * limits.rest_s / limits.period_s) :]
        out[part] = new[:length]
    elif kind == 2:  # larger or smaller about rest
        out[part] = limits.rest_rad + (out[part] - limits.rest_rad) * np.exp(0.3 * rng.normal())
    else:  # by smooth random changes
        width = float(np.exp(rng.uniform(np.log(1.0), np.log(12.0))))
        noise = gaussian_filter1d(rng.normal(size=out[part].shape), width, axis=0)
        size = limits.reach_rad * np.exp(rng.uniform(np.log(0.03), np.log(0.4)))
        out[part] += size * noise / max(float(noise.std()), 1e-12)
    return out
