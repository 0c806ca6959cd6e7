"""The clock of a recording: sampling rate, gaps and findings about its times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError

GAP = 2.5  # median steps
SLOWEST_RATE_HZ = 20.0
SHORTEST_PERIOD_S = 20e-6
"""50 kHz: current loops of motor drives are not faster; servo buses run at a tenth of it."""
LONGEST_PERIOD_S = 0.5
"""Servos complete a motion in less time: their dynamics are not visible at a slower rate."""
LONGEST_COMMAND_PERIOD_S = 10.0
"""Set-points may be waypoints that are held for seconds."""
UNITS = (("milliseconds", 1e-3), ("microseconds", 1e-6), ("nanoseconds", 1e-9))


@dataclass(frozen=True)
class Timing:
    """The clock of a recording.

    Attributes:
        rate_hz: One over the median step between samples.
        jitter_s: Standard deviation of the steps without gaps.
        gaps: Start and length in s of every pause of more than 2.5 median steps.
        missing_cells: Number of missing positions of all joints.
    """

    rate_hz: float
    jitter_s: float
    gaps: tuple[tuple[float, float], ...]
    missing_cells: int


def timing(t: Array, position: Array) -> Timing:
    """Measure the sampling rate, jitter and gaps of a recording.

    Args:
        t: Times in s, shape (T,).
        position: Measured angles, NaN where missing, shape (T, J).
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    long = steps > GAP * usual
    return Timing(
        rate_hz=1 / usual,
        jitter_s=float(steps[~long].std()),
        gaps=tuple((float(t[k]), float(steps[k])) for k in np.flatnonzero(long)),
        missing_cells=int(np.isnan(position).sum()),
    )


def check_sampling(
    file: str | PathLike[str], t: Array, longest_s: float = LONGEST_PERIOD_S
) -> None:
    """Check that the intervals of the times ``t`` (T,) are plausible for samples of a servo.

    The upper quartile of the steps is checked: rows may come in pairs, such as a set-point and an
    angle a few microseconds later.

    Raises:
        InputError: If that step is below 20 us or above ``longest_s``; the message names the
            unit in which the times would be plausible.
    """
    if t.size < 2:
        raise InputError(file, "t_s", f"{t.size} sample", "at least two")
    usual = float(np.quantile(np.diff(t), 0.75))
    if SHORTEST_PERIOD_S <= usual <= longest_s:
        return
    plausible = (unit for unit, size in UNITS if 1e-4 <= usual * size <= LONGEST_PERIOD_S)
    unit = next(plausible, None) if usual > longest_s else "minutes or hours"
    hint = f" (are the times in {unit}?)" if unit else ""
    expected = f"between {1e6 * SHORTEST_PERIOD_S:g} us and {longest_s:g} s, with t_s in s{hint}"
    raise InputError(file, "t_s", f"samples {usual:.4g} s apart", expected)


def clock_findings(t: Array, clock: Timing) -> Iterator[str]:
    """Findings about the times ``t`` (T,), whose statistics are ``clock``."""
    steps, usual = np.diff(t), 1 / clock.rate_hz
    doubled, short = int(np.sum(steps < 0.01 * usual)), int(np.sum(steps < 0.2 * usual))
    if doubled:
        often = "Once" if doubled == 1 else f"{doubled} times"
        yield f"{often} a sample has almost the time of the previous one: it may be a duplicate."
    if short - doubled > max(1, steps.size // 200):
        yield (
            f"{short - doubled} samples follow the previous one within a fifth of the median step: "
            "the times are probably those of arrival, in bunches, and not of measurement."
        )
    quarter = max(1, steps.size // 4)
    first, last = (float(np.median(part)) for part in (steps[:quarter], steps[-quarter:]))
    if abs(first / last - 1) > 0.03:
        yield f"The sampling rate changes from {1 / first:.4g} to {1 / last:.4g} Hz."
    elif clock.jitter_s > 0.2 * usual:
        varies = 100 * clock.jitter_s / usual
        yield f"The sampling rate is far from constant: steps vary by {varies:.0f} %."
    if clock.rate_hz < SLOWEST_RATE_HZ:
        yield (
            f"At {clock.rate_hz:.3g} Hz a servo's latency and damping (tens of milliseconds) "
            "are hardly identifiable."
        )
    if clock.gaps:
        start, longest = max(clock.gaps, key=lambda gap: gap[1])
        number = "A gap" if len(clock.gaps) == 1 else f"{len(clock.gaps)} gaps, the longest"
        yield f"{number} of {longest:.3g} s, starting at {start:.4g} s."
