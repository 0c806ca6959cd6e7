"""The clock of a recording: sampling rate, gaps and findings about its times."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, RecordingFinding

GAP = 2.5  # median steps
SHORTEST_PERIOD_S = 20e-6
"""50 kHz: current loops of motor drives are not faster; servo buses run at a tenth of it."""
LONGEST_PERIOD_S = 0.5
"""Servos complete a motion in less time: their dynamics are not visible at a slower rate."""
LONGEST_COMMAND_PERIOD_S = 10.0
"""Set-points may be waypoints that are held for seconds."""
LONGEST_PAUSES_S = 30.0
"""Longest time of a recording without samples, unless the samples take longer: servos are simulated
through it."""
UNITS = (("seconds", 1.0), ("milliseconds", 1e-3), ("microseconds", 1e-6), ("nanoseconds", 1e-9))


@dataclass(frozen=True)
class Timing:
    """The clock of a recording's measurements."""

    rate_hz: float  # one over the median step between measurements
    jitter_s: float
    """Standard deviation of the steps without gaps; a step of several usual ones, over measurements
    that are missing, counts by its difference from their sum."""
    gaps: tuple[tuple[float, float], ...]  # start and length of pauses of over 2.5 median steps, s
    missing_cells: int  # missing positions of all joints, see ``missing_samples``


def timing(t: Array, position: Array) -> Timing:
    """Sampling of angles (T, J), NaN where missing, at ``t`` (T,) in s, of the rarest joint."""
    measured = [_times(t, angle) for angle in position.T]
    slowest = max(measured, key=lambda times: float(np.median(np.diff(times))))
    steps = np.diff(slowest)
    usual = float(np.median(steps))
    long = steps > GAP * usual
    several = _multiples(steps, usual)
    return Timing(
        rate_hz=1 / usual,
        jitter_s=float((steps - (several - 1) * usual)[~long].std()),
        gaps=tuple((float(slowest[k]), float(steps[k])) for k in np.flatnonzero(long)),
        missing_cells=sum(missing_samples(t, angle) for angle in position.T),
    )


def missing_samples(t: Array, angle: Array) -> int:
    """Number of measurements of one joint that were due, by its angles (T,), NaN where missing."""
    rows = np.flatnonzero(np.isfinite(angle))
    if rows.size < 2:
        return int(angle.size - rows.size)
    ends = np.r_[t[0], t[rows], t[-1]]
    usual = float(np.median(np.diff(t[rows])))
    due = np.floor(np.diff(ends) / usual + 0.1)
    due[1:-1] = np.round(np.diff(t[rows]) / usual) - 1  # its last one is there
    empty = np.diff(np.r_[-1, rows, angle.size]) - 1
    return int(np.minimum(empty, np.maximum(due, 0)).sum())


def _times(t: Array, angle: Array) -> Array:
    """Times of the measurements of one joint, or of all rows if there are too few."""
    measured = t[np.isfinite(angle)]
    return measured if measured.size > 1 else t


def _multiples(steps: Array, usual: float) -> Array:
    """Number of usual steps in each step where that is nearly whole, otherwise 1."""
    whole = np.maximum(np.round(steps / usual), 1)
    return np.where(np.abs(steps / usual - whole) < 0.1, whole, 1.0)


def check_sampling(
    file: str | PathLike[str],
    t: Array,
    longest_s: float = LONGEST_PERIOD_S,
    *,
    where: str = "t_s",
    unit_s: float = 1.0,
) -> None:
    """Raise InputError unless the times ``t`` (T,) in s are plausible for samples of a servo.

    The upper quartile of the steps is checked: rows may come in pairs. ``where`` is what states the
    times, ``unit_s`` the unit from which they were converted.
    """
    if t.size < 2:
        raise InputError(file, where, f"{t.size} sample", "at least two")
    steps = np.diff(t)
    usual = float(np.quantile(steps, 0.75))
    if not SHORTEST_PERIOD_S <= usual <= longest_s:
        stated = usual / unit_s
        plausible = (unit for unit, size in UNITS if 1e-4 <= stated * size <= LONGEST_PERIOD_S)
        unit = next(plausible, None) or ("minutes or hours" if usual < SHORTEST_PERIOD_S else None)
        hint = f" (are the times in {unit}?)" if unit else ""
        limits = f"between {1e6 * SHORTEST_PERIOD_S:g} us and {longest_s:g} s"
        expected = f"{limits}, with {where} in s{hint}" if where == "t_s" else f"{limits}{hint}"
        raise InputError(file, where, f"samples {usual:.4g} s apart", expected)
    paused = float(steps[steps > GAP * usual].sum())
    longest_pauses_s = LONGEST_PAUSES_S * longest_s / LONGEST_PERIOD_S
    if paused > max(longest_pauses_s, t.size * usual):
        row = int(np.argmax(steps))
        found = f"{paused:.4g} s without samples, of which {steps[row]:.4g} s after {t[row]:.4g} s"
        expected = f"at most {longest_pauses_s:g} s (was the clock set? cut the recording there)"
        raise InputError(file, where, found, expected)


def recording_clock_findings(
    joints: Sequence[str], t: Array, position: Array
) -> list[RecordingFinding]:
    """Findings about the times ``t`` (T,) at which angles (T, J), NaN where not, were measured."""
    concerned: dict[RecordingFinding, list[str]] = {}
    for joint, angle in zip(joints, position.T, strict=True):
        found = [RecordingFinding(text) for text in clock_findings(_times(t, angle))]
        found += [RecordingFinding(text, "warning") for text in dropped_rows(t, angle)]
        for finding in found:
            concerned.setdefault(finding, []).append(joint)
    return [
        x if len(some) == len(joints) else replace(x, text=f"{', '.join(some)}: {x.text}")
        for x, some in concerned.items()
    ]


def dropped_rows(t: Array, angle: Array) -> Iterator[str]:
    """A finding about single missing rows, where steps between angles (T,) are doubled."""
    rows = np.flatnonzero(np.isfinite(angle))
    if rows.size < 3:
        return
    steps = np.diff(t[rows])
    usual = float(np.median(steps))
    jitter = timing(t[rows], np.zeros((rows.size, 1))).jitter_s
    twice = (np.diff(rows) == 1) & (_multiples(steps, usual) == 2)
    if jitter < 0.1 * usual and twice.sum() > max(1, 0.01 * steps.size):
        first = t[rows[np.flatnonzero(twice)[0]]]
        yield (
            f"{twice.sum()} samples are missing one at a time ({100 * twice.mean():.2g} % of the "
            f"steps are twice the usual step), the first after {first:.4g} s. When set-points were "
            "sent in between is not known, which looks like irregular timing."
        )


def clock_findings(t: Array) -> Iterator[str]:
    """Findings about times of measurements (T,), one sentence each."""
    clock = timing(t, np.zeros((t.size, 1)))
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
    if clock.rate_hz < 20.0:
        times = "latency and damping (tens of milliseconds)"
        yield f"At {clock.rate_hz:.3g} Hz a servo's {times} are hardly identifiable."
    if clock.gaps:
        start, longest = max(clock.gaps, key=lambda gap: gap[1])
        number = "A gap" if len(clock.gaps) == 1 else f"{len(clock.gaps)} gaps, the longest"
        yield f"{number} of {longest:.3g} s, starting at {start:.4g} s."
