"""Faults of the measured angles of one joint: wrong readings, wraps, repeats, departures, a lead.

Angles are in rad, shape (T,), NaN where missing. The limits separate recordings of several plants
from the same with faults put into them (``benchmarks/recording_findings.py``).
"""

from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.inference.segments import runs

SMALLEST_ERROR_RAD = 0.2
"""Smallest distance of a wrong reading from its neighbours."""
UNEXPLAINED_RATIO = 3.0
"""Smallest ratio of the variance unexplained by the best later shift to that by the best earlier
one. It is at most 2.0 for the joints of shipped, real and generated recordings, and above 3 for
99 % of them with command and position swapped (``benchmarks/recording_findings.py``)."""


def wrong_readings(position: Array) -> Mask:
    """Mask (T,) of isolated readings that are far from those before and after them.

    A reading is compared with the median of seven, by ``SMALLEST_ERROR_RAD`` and five times the
    spread of the three middle ones.
    """
    result = np.zeros(position.shape, dtype=bool)
    measured = np.flatnonzero(np.isfinite(position))
    if measured.size < 7:
        return result
    angle = position[measured]
    window = np.lib.stride_tricks.sliding_window_view(np.pad(angle, 3, mode="edge"), 7)
    low, middle, high = np.partition(window, (2, 3, 4), axis=1)[:, 2:5].T
    limit = np.maximum(SMALLEST_ERROR_RAD, 5 * (high - low))
    result[measured] = np.abs(angle - middle) > limit
    return result


def wraps(position: Array) -> tuple[Index, Array]:
    """Samples after jumps by the range of an angle's sensor, and the jumps in rad, (N,) each.

    They are by more than 3 rad, and by more than four times those before and after them.
    """
    measured = np.flatnonzero(np.isfinite(position) & ~wrong_readings(position))
    jump = np.diff(position[measured])
    size = np.abs(jump)
    around = np.maximum(np.r_[0.0, size[:-1]], np.r_[size[1:], 0.0]) if size.size else size
    found = (size > 3.0) & (size > 4 * around)
    return measured[1:][found], jump[found]


def interleaved_constant(position: Array) -> tuple[float, int] | None:
    """A constant in the place of single readings, far from neighbours, and how often; or None.

    It is there at least five times, and in one sample of a hundred.
    """
    angle = position[np.isfinite(position)]
    step = np.diff(angle)
    there, back = step[:-1], step[1:]
    away = (np.minimum(np.abs(there), np.abs(back)) > SMALLEST_ERROR_RAD) & (there * back < 0)
    values, counts = np.unique(angle[1:-1][away], return_counts=True)
    if not counts.size:
        return None
    most = int(np.argmax(counts))
    count = int(counts[most])
    # Turning points of a fast motion are isolated as well, but on either side of it.
    next_count = int(np.partition(counts, -2)[-2]) if counts.size > 1 else 0
    if count < max(5, 0.01 * angle.size, 2 * next_count):
        return None
    return float(values[most]), count


def stale_share(position: Array, step_rad: float, noise_rad: float) -> float:
    """Share of readings that repeat the previous one although the joint turns steadily.

    It turns where the angle changes by more than five steps of the sensor and five standard
    deviations before and after, to the same side. 0 if no more repeat than by chance: fewer than
    five, or than 3 %.
    """
    change = np.diff(position[np.isfinite(position)])
    turn = 5 * max(step_rad, noise_rad)
    before, pair, after = change[:-2], change[1:-1], change[2:]
    steady = (np.minimum(np.abs(before), np.abs(after)) > turn) & (before * after > 0)
    repeated, turning = int(np.sum(steady & (pair == 0))), int(np.sum(steady))
    return repeated / turning if repeated >= max(5, 0.03 * turning) else 0.0


@dataclass(frozen=True)
class Departure:
    """Where an angle does not follow its command."""

    windows_s: tuple[tuple[float, float], ...]  # start and end of each, in order of time
    largest_rad: float  # largest sustained distance of the angle from its command
    held_rad: float | None  # angle at which it stays meanwhile; None if it moves


def departure(t: Array, command: Array, position: Array, gravity: bool) -> Departure | None:
    """Where an angle does not follow its command (T,) in rad, if it does not for half a second.

    Both are smoothed over a second, the angle is advanced by its latency, at most 0.3 s, and with
    ``gravity`` the deflection by a pendulum's weight, which is proportional to the sine of the
    angle, is left out. What remains of a servo that follows is a small share of the command's
    range: less than a quarter, or 0.1 rad.
    """
    good = np.isfinite(position) & ~wrong_readings(position)
    step_s, sustained, half, longest_lag = 0.02, 25, 25, 15
    grid = np.arange(t[0], t[-1], step_s)
    if good.sum() < 2 or grid.size < 4 * sustained:
        return None
    sent = _smoothed(np.interp(grid, t, command), half)
    angle = _smoothed(np.interp(grid, t[good], position[good]), half)
    errors = []
    for lag in range(longest_lag + 1):
        advanced = np.append(angle[lag:], np.full(lag, angle[-1]))
        error, sine = advanced - sent, np.sin(advanced)
        if gravity and (square := float(sine @ sine)) > 0:
            error = error - min(0.0, float(error @ sine) / square) * sine  # only if it is a droop
        errors.append(error)
    error = np.abs(min(errors, key=lambda some: float(some @ some)))
    limit = max(0.1, 0.25 * float(np.ptp(sent)))
    windows = [(a, b) for a, b in runs(error > limit) if b - a >= sustained]
    if not windows:
        return None
    inside = np.concatenate([np.arange(a, b) for a, b in windows])
    there = np.interp(grid[inside], t[good], position[good])
    low, held, high = (float(x) for x in np.quantile(there, [0.15, 0.5, 0.85]))
    return Departure(
        windows_s=tuple((float(grid[a]), float(grid[b - 1])) for a, b in windows),
        largest_rad=float(error[inside].max()),
        held_rad=held if high - low < 0.2 * limit else None,
    )


def _smoothed(signal: Array, size: int) -> Array:
    """The signal (N,), averaged twice over ``size`` samples."""
    for _ in range(2):
        padded = np.pad(signal, (size // 2, size - 1 - size // 2), mode="edge")
        total = np.cumsum(np.r_[0.0, padded])
        signal = (total[size:] - total[:-size]) / size
    return signal


def lead_s(t: Array, command: Array, position: Array) -> float | None:
    """Time in s by which the position leads its command (T,); None unless it clearly does.

    A servo is causal: no delay, filter or friction makes a position match its command best at an
    earlier time. The best earlier shift leaves less than half of the variance unexplained (one
    minus the squared correlation), the best later one more than a hundredth. The longest lag is
    longer than the longest lead, so that a periodic response, for which they are not
    distinguishable, counts as a lag. 50 to 4000 samples are compared.
    """
    longest_lead_s, longest_lag_s, finest_shift_s = 0.5, 1.0, 0.01
    measured = np.isfinite(position)
    inside = np.flatnonzero((t >= t[0] + longest_lead_s) & (t <= t[-1] - longest_lag_s))
    inside = inside[:: -(-inside.size // 4000) or 1]
    if min(inside.size, measured.sum()) < 50:
        return None
    step = max(finest_shift_s, float(np.median(np.diff(t))))
    shifts = step * np.arange(-int(longest_lead_s / step), int(longest_lag_s / step) + 1)
    shifted = np.interp(t[inside] + shifts[:, None], t[measured], position[measured])
    shifted -= shifted.mean(axis=1, keepdims=True)
    sent = command[inside] - command[inside].mean()
    size = np.sqrt(np.sum(shifted**2, axis=1) * np.sum(sent**2))
    if not size.all() or (shifts < 0).sum() == 0:
        return None
    correlation = np.maximum(shifted @ sent / size, 0.0)
    unexplained = 1 - np.minimum(correlation, 1.0) ** 2
    leads = shifts < -0.5 * step
    lead, lag = (int(np.argmin(np.where(side, unexplained, np.inf))) for side in (leads, ~leads))
    significant = unexplained[lag] > max(UNEXPLAINED_RATIO * unexplained[lead], 0.01)
    return -float(shifts[lead]) if significant and unexplained[lead] < 0.5 else None
