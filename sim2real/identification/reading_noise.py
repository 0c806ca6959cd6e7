"""What of a joint's readings is used, and how the noise of each grows with the joint's speed.

Readings that are far from their neighbours are left out. Where the times of reading jitter, as on a
bus that is polled, the noise grows with speed: a variance of ``rest^2 + (jitter speed)^2``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.search import errors_of
from sim2real.inference.correlated_noise import SlowErrors
from sim2real.inference.least_squares import OUTLIER_SD, robust_scale
from sim2real.inference.normal import SD_PER_MEDIAN
from sim2real.inference.segments import runs
from sim2real.noise import divided_differences
from sim2real.readings import wrong_readings
from sim2real.servo.trace import Trace, sensor_noise


def with_reading_noise(traces: Sequence[Trace], *, slow: bool = False) -> list[Trace]:
    """The traces without wrong readings, with the spread of the noise of the others.

    Where it spreads, also with the usual slow errors of a law if ``slow``.
    """
    if not traces:
        return []
    kept = [without_wrong_readings(trace) for trace in traces]
    known = jitter_s(kept)
    if known is None:
        return kept
    jitter, rest = known
    errors = SlowErrors(rest) if slow else None
    spread = [np.hypot(1.0, jitter * t.speed() / rest) for t in kept]
    return [replace(t, spread=x, slow=errors) for t, x in zip(kept, spread, strict=True)]


def without_wrong_readings(trace: Trace) -> Trace:
    """The trace without single readings that are far from those before and after them."""
    return replace(trace, used=trace.used & ~wrong_readings(trace.position))


def without_releases(trace: Trace, simulated: Array, *, least_rad: float = 0.25) -> Trace:
    """The trace without the times in which the servo has no torque although it is enabled.

    There the shaft does not follow: for 50 ms it is further than ``least_rad`` from where a fitted
    servo would be (``simulated``, in rad, shape (T,)) and does not turn towards that by 0.1 rad/s.
    Nothing is used from where it last was as close as usual until it has been near for 0.3 s.
    """
    shortest_s, recovery_s = 0.05, 0.3
    angle = np.interp(trace.t, trace.t[trace.used], trace.position[trace.used])
    away = simulated - angle
    speed = np.gradient(angle, trace.t)
    lost = (np.abs(away) > least_rad) & (speed * np.sign(away) < 0.1)
    usual = OUTLIER_SD * robust_scale(away[trace.used])
    near = [trace.t[a:b] for a, b in runs(np.abs(away) < min(usual, least_rad))]
    used = trace.used.copy()
    for first, last in runs(lost):
        start, end = trace.t[first], trace.t[last - 1]
        if end - start < shortest_s:
            continue
        close = trace.t[(np.abs(away) < usual) & (trace.t < start - shortest_s)]
        back = [t[0] + recovery_s for t in near if t[0] > end and t[-1] - t[0] > recovery_s]
        since = max(close, default=trace.t[0])
        used &= (trace.t <= since) | (trace.t > min(back, default=np.inf))
    return trace if (used == trace.used).all() else replace(trace, used=used)


def while_powered(traces: Sequence[Trace], *rows: Array) -> list[Trace]:
    """The traces without the times that are releases for each of some servos, (P,) each.

    They are whole where less than half of all readings would remain.
    """
    left = [np.zeros_like(trace.used) for trace in traces]
    for row in rows:
        for used, trace, error in zip(left, traces, errors_of(row, traces), strict=True):
            used |= without_releases(trace, trace.simulated(error)).used
    if sum(map(np.sum, left)) < 0.5 * sum(t.used.sum() for t in traces):
        return list(traces)
    return [replace(trace, used=used) for trace, used in zip(traces, left, strict=True)]


def left_out(traces: Sequence[Trace]) -> Iterator[str]:
    """Sentences about readings that are not used, and about noise that grows with speed."""
    for trace in traces:
        wrong = wrong_readings(trace.position) & np.isfinite(trace.position)
        if wrong.any():
            count, times = int(wrong.sum()), trace.t[wrong]
            readings = "one reading" if count == 1 else f"{count} readings"
            at = ", ".join(f"{t:.2f}" for t in times[:3]) + ", ..." * (count > 3)
            yield (
                f"{readings} of {trace.name} left out, far from those before and after: at {at} s."
            )
        lost = np.isfinite(trace.position) & ~trace.used & ~wrong
        apart = ~trace.used  # with missing and wrong readings, which are no gaps
        gaps = [trace.t[first:last] for first, last in runs(apart) if lost[first:last].any()]
        if gaps:
            windows = " and ".join(f"from {t[0]:.2f} to {t[-1]:.2f} s" for t in gaps)
            yield (
                f"{trace.name} left out {windows}: the servo does not turn towards its set-point, "
                "as without torque."
            )
    known = None if traces[0].spread is None else jitter_s(traces)
    if known is not None:
        jitter = 1e3 * known[0]
        yield f"the noise grows with speed, as of readings whose times vary by {jitter:.1f} ms."


def rest_noise(traces: Sequence[Trace]) -> float:
    """Standard deviation of the noise of a joint at rest, rad."""
    known = None if traces[0].spread is None else jitter_s(traces)
    return sensor_noise(traces) if known is None else known[1]


def jitter_s(traces: Sequence[Trace]) -> tuple[float, float] | None:
    """Standard deviation of the times of reading in s, and of the noise at rest in rad.

    From divided differences of neighbouring readings, so that no model of the servo is needed;
    motion can only increase them, so that the order with the smallest ones counts. None where the
    noise of the fastest readings is less than 4 times that of the slowest, or times vary by less
    than 5 % of a period, as those of a sensor that is read in time; nor where the last order lowers
    them by more than 15 %, as it does where parts collide.
    """
    # orders of divided differences, which cancel polynomial motion of lower degree
    found = [_of_order(traces, order) for order in (4, 5, 6)]
    last, highest = found[-2:]
    if last and highest and highest[0] < 0.85 * last[0]:
        return None
    smallest = min(found, key=lambda one: -1.0 if one is None else one[0])
    period = float(np.median([t.period_s for t in traces]))
    return smallest if smallest is not None and smallest[0] > 0.05 * period else None


def _of_order(
    traces: Sequence[Trace], order: int, *, groups: int = 8
) -> tuple[float, float] | None:
    """``jitter_s`` from differences of one order, by groups of readings of similar speed."""
    parts = [(np.zeros(0), np.zeros(0))]
    for trace in traces:
        t, angle = trace.t[trace.used], trace.position[trace.used]
        if t.size > order:
            speed = np.abs(angle[order:] - angle[:-order]) / (t[order:] - t[:-order])
            parts.append((divided_differences(t, angle, order), speed))
    noise, speed = (np.concatenate(x) for x in zip(*parts, strict=True))
    if noise.size < groups * 20:
        return None
    by_speed = np.argsort(speed, kind="stable")
    slowest = by_speed[: noise.size // groups]
    step = max(t.quantization_step() for t in traces) / np.sqrt(12)
    rest = max(float(np.sqrt(np.mean(noise[slowest] ** 2))), step, 1e-6)
    fast = np.array_split(by_speed, groups)[groups // 2 :]
    sd = np.array([SD_PER_MEDIAN * np.median(np.abs(noise[part])) for part in fast])
    typical = np.array([np.mean(speed[part] ** 2) for part in fast])
    beyond = np.maximum(sd**2 - rest**2, 0.0)
    variance = np.divide(beyond, typical, out=np.zeros_like(beyond), where=typical > 0)
    return (float(np.sqrt(np.median(variance))), rest) if sd[-1] > 4 * rest else None
