"""Where simulation and recording differ: in time and in state, in numbers and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.generic import Smooth
from sim2real.diagnose.investigate import STRUCTURED, Finding
from sim2real.diagnose.result import Mismatch
from sim2real.diagnose.windows import Window, robust_sd, windows
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_THROUGHOUT = 0.9
"""Share of the time from which a mismatch is there all the time."""
_WORDS = {
    "position": "it depends on the position: torque is missing at some angles",
    "speed": "it depends on the speed and its sign: just after reversals above all",
    "error": "it depends on how much torque is asked for: at high load or close to the target",
    "time": "it grows with the time since the start",
    "sensor": "it depends on the position: what is seen is off at some angles",
    "other_joint": "it follows the acceleration of another joint",
    "shaking": "it comes at one frequency, whatever the joint does",
    "jump": "it begins at one instant and stays",
}
_TELLING = 12.0
"""Gain in log-likelihood from which a state is said to drive a mismatch."""


def mismatch(
    finding: Finding,
    joint: str,
    traces: Sequence[Trace],
    residual: Array,
    errors: tuple[float, float],
) -> Mismatch:
    """What is said of a joint that differs.

    Args:
        finding: What was found on the joint.
        joint: Its name.
        traces: Its recordings.
        residual: Simulated minus measured angle of the plain servo in rad, shape (R, T).
        errors: Root mean square error of the plain servo, and the noise, rad.
    """
    rmse, noise = errors
    when = _when(finding, traces, residual, noise)
    smooth = finding.nameless.smooth
    return Mismatch(
        signal=f"{joint}.position_rad",
        component=joint,
        rmse=rmse,
        noise=noise,
        share=max(0.0, 1 - (noise / rmse) ** 2) if rmse > 0 else 0.0,
        windows_s={t.name: w for t, w in zip(traces, when, strict=True)},
        where=_where(smooth, when, traces, intermittent=finding.nameless.windows is not None),
        dependence=dependence(smooth, float(finding.best.fit.count[0])),
    )


def dependence(smooth: Smooth, count: float) -> Mapping[str, float]:
    """Share of the innovations' energy that a smooth function of each state explains."""
    return {
        state: float(1 - np.exp(-2 * max(gain, 0.0) / count))
        for state, gain in sorted(smooth.shares.items(), key=lambda entry: -entry[1])
    }


def _when(
    finding: Finding, traces: Sequence[Trace], residual: Array, noise: float
) -> list[tuple[Window, ...]]:
    nameless = finding.nameless
    if finding.unknown > 0.5 and nameless.windows is not None:
        return list(nameless.windows)
    if finding.unknown > 0.5 and nameless.smooth.state == "jump":
        instants = nameless.smooth.jumps_s
        return [((at, float(t.t[-1])),) for at, t in zip(instants, traces, strict=True)]
    rows = [np.where(t.used, r[: t.t.size], np.nan) for r, t in zip(residual, traces, strict=False)]
    everywhere = np.concatenate(rows)
    spread = robust_sd(everywhere, np.zeros(everywhere.size, dtype=bool))
    sd = max(noise, min(spread, STRUCTURED * noise))
    return [windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True)]


def _where(
    smooth: Smooth,
    when: Sequence[tuple[Window, ...]],
    traces: Sequence[Trace],
    *,
    intermittent: bool,
) -> str:
    best = max(smooth.shares, key=lambda state: smooth.shares[state])
    telling = smooth.shares[best] > _TELLING
    words = _WORDS[best] if telling else "in no state in particular"
    shaded = sum(b - a for w in when for a, b in w)
    if shaded > _THROUGHOUT * sum(float(t.t[-1] - t.t[0]) for t in traces):
        return f"throughout: {words}" if telling else "throughout"
    if intermittent and any(when):
        stretches = [
            f"{a:.1f} to {b:.1f} s of {t.name}"
            for t, w in zip(traces, when, strict=True)
            for a, b in w
        ]
        more = f" and {len(stretches) - 3} more" if len(stretches) > 3 else ""
        return f"in stretches: {', '.join(stretches[:3])}{more}"
    return words
