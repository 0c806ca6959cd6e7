"""What gains and latency, and what size of an effect, make a world likeliest: Gauss-Newton."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from cases import Case
from likelihood import whiten
from numpy.typing import NDArray
from sensor import stick
from world import Hidden, build_world

Array = NDArray[np.float64]

GIVEN = ("a", "b")
ITERATIONS = 4
HALVINGS = 4
HOPELESS = 100.0  # so far behind the goal, and by thrice the last gain, a search is given up
DIFFERENCES = np.array([1e-3, 1e-3, 1e-2, 1e-2])  # of log kp, log kd, latency / 10 ms, log strength


@dataclass(frozen=True)
class Fit:
    """A world for one joint: the offsets (4,) of its gains and strength, and how likely it is."""

    offsets: Array
    loglik: float


def no_offsets() -> Array:
    """The true gains, and strength 1."""
    return np.zeros(4)


def expected(
    case: Case, recording: str, hidden: list[Hidden], joint: int, offsets: Array
) -> tuple[Array, float]:
    """Noise-free readings of ``joint``, rad, shape (T,), and the step they would be rounded to."""
    servos, take = list(case.servos), case.takes[recording]
    servos[joint] = replace(
        servos[joint],
        kp=servos[joint].kp * np.exp(offsets[0]),
        kd=servos[joint].kd * np.exp(offsets[1]),
        latency_s=max(servos[joint].latency_s + 0.01 * offsets[2], 0.0),
    )
    world = build_world(servos, recording, hidden, take.windows)
    seen = world.seen(take.t, take.command, take.chance, [joint])[0]
    if joint in world.stuck:  # what it sticks to is the reading before, noise and all
        stuck = stick(take.measured[:, joint], take.t, take.windows)
        for start, stop in take.windows:
            inside = (take.t >= start) & (take.t < stop)
            seen[inside] = stuck[inside]
    return seen, world.steps_rad[joint]


def evaluate(case: Case, hidden: list[Hidden], joint: int, offsets: Array) -> tuple[Array, float]:
    """Whitened residuals of the given recordings, one after the other, and their likelihood."""
    parts, total = [], 0.0
    sensor = case.servos[joint].sensor
    for recording in GIVEN:
        take = case.takes[recording]
        seen, step = expected(case, recording, hidden, joint, offsets)
        residual = take.measured[:, joint] - seen
        whitened, loglik = whiten(residual, take.t, sensor, step)
        parts.append(whitened)
        # A reading can be any of the steps: a coarser grid makes each of them likelier.
        total += loglik + np.isfinite(residual).sum() * np.log(step / sensor.step_rad)
    return np.concatenate(parts), float(total)


def refit(
    case: Case,
    joint: int,
    hidden: Callable[[float], list[Hidden]],
    start: Array,
    free: int = 3,
    goal: float = -np.inf,
) -> Fit:
    """Refit gains and latency (``free`` 3), or the strength too (``free`` 4), from ``start`` (4,).

    ``hidden`` gives the effects at a logarithm of strength. Each step is halved until it helps. The
    search ends early where it is far from the likelihood ``goal`` and nearing it too slowly.
    """
    offsets = start.copy()
    residual, loglik = evaluate(case, hidden(offsets[3]), joint, offsets)
    for _ in range(ITERATIONS):
        columns = []
        for k in range(free):
            moved = offsets.copy()
            moved[k] += DIFFERENCES[k]
            columns.append(evaluate(case, hidden(moved[3]), joint, moved)[0] - residual)
        jacobian = np.stack(columns, axis=1) / DIFFERENCES[:free]
        step = np.zeros(4)
        step[:free] = -np.linalg.lstsq(jacobian, residual, rcond=1e-8)[0]
        step = np.clip(step, -1.0, 1.0)
        gained = 0.0
        for _ in range(HALVINGS):
            trial, likelier = evaluate(case, hidden((offsets + step)[3]), joint, offsets + step)
            if likelier > loglik:
                gained = likelier - loglik
                offsets, residual, loglik = offsets + step, trial, likelier
                break
            step = step / 2
        if gained < 0.05 or goal - loglik > max(HOPELESS, 3 * gained):
            break
    return Fit(offsets, loglik)
