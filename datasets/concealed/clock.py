"""When the recording computer sends and samples: honest times, in good order or in disorder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from excitation import DURATION_S
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE_HZ = 50.0
JITTER_SD_S = 0.2e-3


@dataclass(frozen=True)
class Disturbance:
    """Disorder of a recording computer; a tick that falls out neither sends nor samples."""

    jitter_sd_s: float
    gaps: int
    single_rows: int


def draw_disturbance(rng: np.random.Generator) -> Disturbance:
    """Worse jitter, gaps, removed duplicates, or several of them."""
    worse, gaps, rows = rng.random(3) < 0.6
    return Disturbance(
        jitter_sd_s=float(rng.uniform(1e-3, 3e-3)) if worse else JITTER_SD_S,
        gaps=int(rng.integers(1, 5)) if gaps or not (worse or rows) else 0,
        single_rows=int(rng.integers(3, 12)) if rows else 0,
    )


def ordinary_ticks(rng: np.random.Generator) -> Array:
    """Sample times in s, shape (1501,), at 50 Hz with 0.2 ms of jitter."""
    return _times(np.arange(int(DURATION_S * RATE_HZ) + 1), JITTER_SD_S, rng)


def disturbed_ticks(disturbance: Disturbance, rng: np.random.Generator) -> Array:
    """Sample times in s, shape (T,), as the disturbance leaves them."""
    ticks = np.arange(int(DURATION_S * RATE_HZ) + 1)
    out = rng.integers(60, ticks.size - 60, size=disturbance.single_rows)
    for _ in range(disturbance.gaps):
        start = int(rng.integers(60, ticks.size - 60))
        out = np.concatenate([out, start + np.arange(int(rng.integers(4, 30)))])
    return _times(np.delete(ticks, np.unique(out)), disturbance.jitter_sd_s, rng)


def empty_cells(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which readings are missing: up to 3 % of them."""
    return rng.random(shape) < rng.uniform(0.0, 0.03)


def _times(ticks: NDArray[np.int64], jitter_sd_s: float, rng: np.random.Generator) -> Array:
    """Rounded before use: the file holds exactly what happened."""
    jitter = np.clip(rng.normal(0.0, jitter_sd_s, size=ticks.size), -8e-3, 8e-3)
    t = ticks / RATE_HZ + jitter
    return np.round(t - t[0], 6)
