"""Changes outside the catalogue that can be put into a real log, and the windows they last.

``horn_slip`` (an offset from an instant to the end), ``stuck_sensor``, ``potentiometer``,
``sensor_spikes``, ``sensor_dropout`` (holds of a few samples within a window), and
``timestamp_glitch`` (angles late within a window). Parameters hold the window where there is one.
"""

from __future__ import annotations

import numpy as np
from backgrounds import Log, Rng, rate, rms
from numpy.typing import NDArray
from real_effects import ALL, SMOOTH, Change, Parameters, signed

Window = tuple[float, float]


def _inside(log: Log, p: Parameters) -> NDArray[np.bool_]:
    start, stop = p["window_s"]
    return np.asarray((log.t >= start) & (log.t <= stop))


def _slip(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    return log.reads(j, log.position[:, j] + p["slip_rad"] * _inside(log, p))


def _stick(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    inside, angle = _inside(log, p), log.position[:, j].copy()
    angle[inside] = angle[int(np.argmax(inside)) - 1]
    return log.reads(j, angle)


def _bend(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    angle = log.position[:, j]
    bump = np.sin(2 * np.pi * angle / p.get("bump_period_rad", 1.0) + p.get("bump_phase_rad", 0.0))
    return log.reads(
        j, angle + p.get("bend_per_rad", 0.0) * angle**2 + p.get("bump_rad", 0.0) * bump
    )


def _spike(log: Log, j: int, p: Parameters, rng: Rng) -> Log:
    """One sample in five, and the first and last of the window."""
    inside = np.flatnonzero(_inside(log, p))
    hit = inside[rng.random(inside.size) < 0.2]
    hit = np.unique([inside[0], *hit, inside[-1]])
    angle = log.position[:, j].copy()
    angle[hit] += p["spike_rad"] * rng.uniform(1, 3, hit.size) * rng.choice([-1.0, 1.0], hit.size)
    return log.reads(j, angle)


def _drop_out(log: Log, j: int, p: Parameters, rng: Rng) -> Log:
    """Holds of up to ``longest`` samples, each followed by one good sample."""
    inside, angle = np.flatnonzero(_inside(log, p)), log.position[:, j].copy()
    k = int(inside[0])
    while k <= inside[-1]:
        stop = min(k + int(rng.integers(1, p["longest"] + 1)), int(inside[-1]) + 1)
        angle[k:stop] = angle[k - 1]
        k = stop + 1
    return log.reads(j, angle)


def _late(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    angle = log.position[:, j]
    old = np.interp(log.t - p["late_s"], log.t, angle)
    return log.reads(j, np.where(_inside(log, p), old, angle))


def _draw_bend(log: Log, j: int, size: float, rng: Rng) -> Parameters:
    angle = log.position[:, j]
    if rng.random() < 0.4:
        return {"bend_per_rad": signed(size / rms(angle**2), rng)}
    return {
        "bump_rad": size,
        "bump_period_rad": float(np.ptp(angle) * rng.uniform(0.4, 0.7)),
        "bump_phase_rad": float(rng.uniform(0, 2 * np.pi)),
    }


OUTSIDERS = {
    "horn_slip": Change(
        "time", ALL, lambda g, j, size, rng: {"slip_rad": signed(size, rng)}, _slip,
        lasts_s=(np.inf, np.inf),
    ),
    "stuck_sensor": Change(
        "time", ALL, lambda g, j, size, rng: {}, _stick, lasts_s=(0.4, 1.2)
    ),
    "potentiometer": Change("position", ALL, _draw_bend, _bend),
    "sensor_spikes": Change(
        "time", ALL, lambda g, j, size, rng: {"spike_rad": size}, _spike, lasts_s=(0.6, 1.5)
    ),
    "sensor_dropout": Change(
        "time", SMOOTH, lambda g, j, size, rng: {"longest": int(rng.integers(8, 25))}, _drop_out,
        lasts_s=(0.8, 2.0),
    ),
    "timestamp_glitch": Change(
        "time", SMOOTH,
        lambda g, j, size, rng: {
            "late_s": float(np.clip(2 * size / rms(rate(g.position[:, j], g.t)), 0.02, 0.25))
        },
        _late,
        lasts_s=(0.4, 1.5),
    ),
}  # fmt: skip


def draw_window(change: Change, log: Log, rng: Rng) -> Window:
    """A window away from the ends that begins and ends at samples, or lasts to the end."""
    assert change.lasts_s is not None
    first, last = log.t[0], log.t[-1]
    if np.isinf(change.lasts_s[1]):
        start, stop = first + (last - first) * rng.uniform(0.3, 0.75), last
    else:
        length = rng.uniform(*change.lasts_s)
        start = rng.uniform(first + 0.5, last - 0.3 - length)
        stop = start + length
    inside = np.flatnonzero((log.t >= start) & (log.t <= stop))
    return float(log.t[inside[0]]), float(log.t[inside[-1]])
