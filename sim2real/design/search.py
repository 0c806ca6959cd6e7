"""Search for the best command: random designs of all families, then local refinement in batches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from sim2real.arrays import Array
from sim2real.design.candidates import draw
from sim2real.design.limits import CommandLimits, within

Objective = Callable[[Array], Array]
"""A function of commands (N, T) in rad that returns their scores (N,); larger is better, and
-inf excludes a command."""


@dataclass(frozen=True)
class Found:
    """Result of a search.

    Attributes:
        command: The best command in rad, shape (T,).
        score: Its score.
        scores: Best score after each batch.
        evaluated: Number of commands that were evaluated.
    """

    command: Array
    score: float
    scores: tuple[float, ...]
    evaluated: int


def best(
    objective: Objective,
    limits: CommandLimits,
    seconds: float,
    *,
    rng: np.random.Generator,
    drawn: int = 384,
    rounds: int = 24,
    batch: int = 32,
    elite: int = 8,
    start: Array | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Found:
    """The command with the highest score among random ones and variations of the best.

    Args:
        objective: Scores of commands (N, T).
        limits: Limits of the commands.
        seconds: Duration, s.
        rng: Random number generator.
        drawn: Number of random commands of the first stage.
        rounds: Number of batches of variations.
        batch: Number of commands that are evaluated together.
        elite: Number of the best commands that are varied.
        start: Commands (M, T) that are evaluated in addition to the random ones.
        progress: Called with the share that is done.
    """
    pool = draw(rng, drawn, limits, seconds)
    if start is not None:
        pool = np.vstack([within(start, limits), pool])
    batches = np.array_split(pool, max(1, -(-len(pool) // batch)))
    total, evaluated = len(batches) + rounds, len(pool)
    score = np.empty(0)
    for k, part in enumerate(batches):
        score = np.append(score, objective(part))
        progress((k + 1) / total)
    history = [float(score.max())]
    for k in range(rounds):
        order = np.argsort(-score)[:elite]
        pool, score = pool[order], score[order]
        varied = within(_variations(pool, batch, limits, rng), limits)
        pool, score = np.vstack([pool, varied]), np.append(score, objective(varied))
        evaluated += batch
        history.append(float(score.max()))
        progress((len(batches) + k + 1) / total)
    first = int(np.argmax(score))
    return Found(pool[first], float(score[first]), tuple(history), evaluated)


def _variations(elite: Array, count: int, limits: CommandLimits, rng: np.random.Generator) -> Array:
    """Variations (count, T) of the best commands (M, T), which are sorted."""
    parent = np.minimum(rng.geometric(0.35, count) - 1, len(elite) - 1)
    out = np.empty((count, elite.shape[1]))
    for n, p in enumerate(parent):
        vary = _VARIATIONS[int(rng.integers(len(_VARIATIONS)))]
        out[n] = vary(elite[p], elite, limits, rng)
    return out


def _window(T: int, rng: np.random.Generator) -> slice:
    """A random part of the recording, of about a thirtieth to a half of it."""
    length = int(T * np.exp(rng.uniform(np.log(0.03), np.log(0.5))))
    start = int(rng.integers(0, T - length))
    return slice(start, start + length)


def _crossed(
    command: Array, elite: Array, limits: CommandLimits, rng: np.random.Generator
) -> Array:
    """A part replaced by a part of another command, from anywhere in it."""
    out, part = command.copy(), _window(command.size, rng)
    length = part.stop - part.start
    start = int(rng.integers(0, command.size - length))
    out[part] = elite[int(rng.integers(len(elite)))][start : start + length]
    return out


def _redrawn(
    command: Array, elite: Array, limits: CommandLimits, rng: np.random.Generator
) -> Array:
    """A part replaced by a new random command."""
    out, part = command.copy(), _window(command.size, rng)
    seconds = (part.stop - part.start) * limits.period_s + 4 * limits.rest_s
    new = draw(rng, 1, limits, seconds)[0][round(2 * limits.rest_s / limits.period_s) :]
    out[part] = new[: part.stop - part.start]
    return out


def _rescaled(
    command: Array, elite: Array, limits: CommandLimits, rng: np.random.Generator
) -> Array:
    """A part made larger or smaller about rest."""
    out, part = command.copy(), _window(command.size, rng)
    out[part] = limits.rest_rad + (out[part] - limits.rest_rad) * np.exp(0.3 * rng.normal())
    return out


def _stretched(
    command: Array, elite: Array, limits: CommandLimits, rng: np.random.Generator
) -> Array:
    """A part played faster or slower."""
    out, part = command.copy(), _window(command.size, rng)
    length, rate = part.stop - part.start, float(np.exp(0.25 * rng.normal()))
    source = part.start + rate * np.arange(length)
    out[part] = np.interp(source, np.arange(command.size), command)
    return out


def _disturbed(
    command: Array, elite: Array, limits: CommandLimits, rng: np.random.Generator
) -> Array:
    """Smooth random changes of a part."""
    out, part = command.copy(), _window(command.size, rng)
    width = float(np.exp(rng.uniform(np.log(1.0), np.log(12.0))))
    noise = gaussian_filter1d(rng.normal(size=part.stop - part.start), width)
    size = limits.reach_rad * np.exp(rng.uniform(np.log(0.03), np.log(0.4)))
    out[part] += size * noise / max(float(noise.std()), 1e-12)
    return out


_VARIATIONS = (_crossed, _redrawn, _rescaled, _stretched, _disturbed)
