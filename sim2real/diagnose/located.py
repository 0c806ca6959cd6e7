"""Where a residual is: in which part of a joint's motion, or at one frequency, as of a rattle.

An output that is free in its gap bounces between the flanks of its gears, also at rest. The limit
cycle is chaotic, so no trajectory fit can follow it; what remains is a narrow peak in the spectrum
at its frequency or an alias of it. A vibration from outside has such a peak too.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import periodogram

from sim2real.arrays import Array, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.inference.segments import most_uneven
from sim2real.servo.trace import Trace
from sim2real.units import readable, three_digits

BAND_HZ, LOWEST_HZ = 1.0, 4.0
"""Width of a band of the spectrum, and where bands begin."""
GAP_SHARES = 0.035, 0.2
"""Standard deviation of a rattle over the gap, of 16 simulated gear trains at rest.

With friction or a weight that holds the output, or with well damped flanks, none rattles."""


@dataclass(frozen=True)
class Rattle:
    """A rattle of a joint."""

    frequency_Hz: float  # of the peak, or an alias
    sd_rad: float  # its standard deviation
    ratio: float  # power in the peak's band over the median band

    def __str__(self) -> str:
        """The rattle in words, with the gaps that would make it."""
        gaps = (self.sd_rad / share for share in GAP_SHARES)
        size, most, least = (readable("gap_rad", x) for x in (self.sd_rad, *gaps))
        return (
            f"also at rest: a rattle of {size} near {self.frequency_Hz:.0f} Hz or an alias, as of "
            f"gears with a gap of {least} to {most}, or a vibration from outside"
        )


def rattles(joints: Sequence[Sequence[Trace]], residuals: Array) -> list[Rattle | None]:
    """The rattle of each of N joints, None without one, from residuals in rad, shape (N, R, T).

    What several joints have at one frequency is a vibration of the bench.
    """
    found = []
    for traces, of_joint in zip(joints, residuals, strict=True):
        pairs = zip(traces, of_joint, strict=False)
        found.append(rattle([t.t for t in traces], [r[: t.t.size] for t, r in pairs]))
    at = np.array([one.frequency_Hz if one else np.nan for one in found])
    alone = (np.abs(at[:, None] - at) <= BAND_HZ).sum(axis=1) == 1
    return [one if single else None for one, single in zip(found, alone, strict=True)]


def rattle(
    times: Sequence[Array], residuals: Sequence[Array], least: float = DECISION.report.rattle_ratio
) -> Rattle | None:
    """The peak in the spectra of a joint's residuals in rad at times in s, None without one.

    The peak's band has ``least`` times the power of the median band, and twice that of every band
    from the lowest to two below it: the residual of a motion that is modelled badly falls with
    frequency instead.
    """
    spectra = []
    for t, residual in zip(times, residuals, strict=True):
        known, step = np.isfinite(residual), float(np.median(np.diff(t)))
        even = np.interp(np.arange(t[0], t[-1], step), t[known], residual[known])
        frequency, density = periodogram(even, 1 / step, "hann")
        edges = np.arange(LOWEST_HZ, frequency[-1], BAND_HZ)
        spectra.append(np.histogram(frequency, edges, weights=density * frequency[1])[0])
    count = min((s.size for s in spectra), default=0)
    if count < 6:
        return None
    power = np.mean([s[:count] for s in spectra], axis=0)
    floor, top = float(np.median(power)), int(power.argmax())
    ratio = float(power[top]) / max(floor, 1e-300)
    moving = top < 2 or (2 * power[: top - 1] > power[top]).any()
    if moving or ratio < least:
        return None
    around = power[top - 2 : top + 3]
    sd = float(np.sqrt(np.sum(np.maximum(around - floor, 0.0))))
    return Rattle(LOWEST_HZ + BAND_HZ * (top + 0.5), sd, ratio)


def remainder(traces: Sequence[Trace], residuals: Array, noise: float) -> str:
    """A sentence on residuals in rad, shape (R, T), beyond a noise of this standard deviation, rad.

    It is empty where they are no more than joints leave that miss nothing.
    """
    pairs = zip(traces, residuals, strict=False)
    square = np.concatenate([trace.standardised(x[: trace.t.size]) ** 2 for trace, x in pairs])
    used = np.concatenate([trace.used for trace in traces]) & np.isfinite(square)
    if not used.any() or square[used].mean() <= DECISION.structured_excess * noise**2:
        return ""
    beyond = np.maximum(square[used] - noise**2, 0.0)
    part = most_uneven(beyond, ((words, mask[used], x) for words, mask, x in _parts(traces)))
    if part is None:
        return "The model leaves an error that is spread over the whole motion."
    return f"The model leaves an error, {part}. {part.advice} to learn more."


def _parts(
    traces: Sequence[Trace], *, slowest: float = 0.03, levels: Sequence[float] = (0.5, 0.75, 0.9)
) -> Iterator[tuple[str, Mask, str]]:
    """Parts of the motion: words, samples of all recordings, and what to record.

    A joint rests below the share ``slowest`` of its fastest speeds; ``levels`` are quantiles.
    """
    speeds = [trace.speed() for trace in traces]
    speed = np.concatenate(speeds)
    rest = slowest * float(np.quantile(np.abs(speed), 0.99))
    yield "at rest", np.abs(speed) <= rest, "Record longer holds, reached from both sides,"
    pairs = zip(traces, speeds, strict=True)
    reversal = np.concatenate([_near_reversals(trace.t, v, rest) for trace, v in pairs])
    yield "near reversals", reversal, "Record slow reversals of several amplitudes"
    for words, mask in (("forwards", speed > rest), ("backwards", speed < -rest)):
        yield f"while turning {words}", mask, "Record the same motion mirrored"
    early = np.concatenate([trace.t - trace.t[0] < 1.0 for trace in traces])
    yield "in the first second", early, "Record the start from rest several times"
    error = np.abs(np.concatenate([trace.command - trace.measured for trace in traces]))
    for x in np.nanquantile(error, levels):
        words = f"where the angle is more than {three_digits(float(x))} rad from its set-point"
        yield words, error > x, "Record steps of several sizes"
    moving = np.abs(speed[np.abs(speed) > rest])
    for x in np.quantile(moving, levels) if moving.size else ():
        words = f"{three_digits(float(x))} rad/s"
        yield f"at speeds above {words}", np.abs(speed) > x, "Record ramps of several high speeds"
        slow = (np.abs(speed) > rest) & (np.abs(speed) <= x)
        yield f"at speeds below {words}", slow, "Record ramps of several low speeds"


def _near_reversals(
    t: Array, speed: Array, rest: float, *, before_s: float = 0.05, after_s: float = 0.2
) -> Mask:
    """Whether a sample is at most so long before or after the joint begins to turn back."""
    moving = np.flatnonzero(np.abs(speed) > rest)
    start = t[moving[1:][np.diff(np.sign(speed[moving])) != 0]] - before_s
    since = t - np.concatenate([[-np.inf], start])[np.searchsorted(start, t, side="right")]
    return np.asarray(since <= before_s + after_s)
