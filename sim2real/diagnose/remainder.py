"""In which part of a joint's motion the error is that a model leaves, how much, what to record.

Of some parts of the motion (near reversals, fast, slow, at rest, one direction, far from the
set-point, early) that one is told whose share of the squared error differs most from its share of
the time, by the relative entropy of the two.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.servo.linearised import smooth_speed
from sim2real.servo.trace import Trace
from sim2real.units import three_digits


def remainder(
    traces: Sequence[Trace], residuals: Array, noise: float, *, least: float = 0.1
) -> str:
    """A sentence on residuals in rad, shape (R, T), beyond a noise of this standard deviation, rad.

    It is empty where they are no more than joints leave that miss nothing. ``least`` is the
    relative entropy from which a part is told, as of 72 % of the squared error in half of the time.
    """
    pairs = list(zip(traces, residuals, strict=False))
    square = np.concatenate([trace.standardised(x[: trace.t.size]) ** 2 for trace, x in pairs])
    used = np.concatenate([trace.used for trace in traces]) & np.isfinite(square)
    if not used.any() or square[used].mean() <= DECISION.structured_excess * noise**2:
        return ""
    square -= noise**2
    found = []
    for words, mask, advice in _parts(traces):
        time = float(mask[used].mean())
        share = min(float(square[used & mask].sum() / square[used].sum()), 1.0)
        if share > time > 0:
            found.append((_entropy(share, time), share, time, words, advice))
    entropy, share, time, words, advice = max(found, default=(0.0, 0.0, 0.0, "", ""))
    if entropy < least:
        return "The error that remains is spread over the whole motion."
    of = f"{100 * share:.0f} % of the squared error that remains beyond the noise is {words}"
    return f"{of}, in {100 * time:.0f} % of the time. {advice} to learn more."


def _entropy(p: float, q: float) -> float:
    """Relative entropy of two shares and their complements."""
    rest = (1 - p) * np.log((1 - p) / (1 - q)) if p < 1 else 0.0
    return float(p * np.log(p / q) + rest)


def _parts(
    traces: Sequence[Trace], *, slowest: float = 0.03, levels: Sequence[float] = (0.5, 0.75, 0.9)
) -> Iterator[tuple[str, Mask, str]]:
    """Parts of the motion: words, samples of all recordings, and what to record.

    A joint rests below the share ``slowest`` of its fastest speeds; ``levels`` are quantiles.
    """
    speeds = [smooth_speed(trace.t, trace.measured) for trace in traces]
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
    for x in np.quantile(np.abs(speed[np.abs(speed) > rest]), levels):
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
