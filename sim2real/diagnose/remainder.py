"""In which part of a joint's motion the error is that a model leaves, how much, what to record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.inference.segments import most_uneven
from sim2real.servo.trace import Trace
from sim2real.units import three_digits


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
