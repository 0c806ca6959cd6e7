"""For joints that miss something without a name: what formula might it have?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decoys import counting
from sim2real.diagnose.directions import simulated
from sim2real.diagnose.formula import Left, formula
from sim2real.diagnose.investigate import Finding
from sim2real.diagnose.linear import response
from sim2real.diagnose.naming import NAMED
from sim2real.diagnose.search import Hypothesis
from sim2real.diagnose.terms import State
from sim2real.diagnose.torque import smooth
from sim2real.servo.trace import PER_INERTIA, Trace

Array = NDArray[np.float64]

_LAGS = 3
"""Samples after a gap that do not count."""


def nameless(finding: Finding) -> bool:
    """Whether a joint misses something that no effect in the catalogue explains."""
    named = any(group.probability >= NAMED for group in finding.groups)
    return finding.mismatch and (finding.unknown > NAMED or not named)


def guesses(
    names: Sequence[str],
    joints: Sequence[Sequence[Trace]],
    findings: Sequence[Finding],
    rich: Sequence[Hypothesis],
    residuals: Sequence[Array],
) -> Mapping[str, str]:
    """Formulas by joint, for those joints that have one.

    Args:
        names: The joints.
        joints: Their recordings.
        findings: What was found on them.
        rich: The servos with what is named.
        residuals: Simulated minus measured angles of these in rad, shape (R, T) each.
    """
    found = {}
    for k, name in enumerate(names):
        if nameless(findings[k]):
            others = [j for j in range(len(names)) if j != k]
            moving = {names[j]: {t.file: t for t in joints[j]} for j in others}
            # The same terms for every recording.
            always = {n: x for n, x in moving.items() if all(t.file in x for t in joints[k])}
            theta = rich[k].fit.servos.theta[0]
            left = [
                what_is_left(trace, row, theta, {n: x[trace.file] for n, x in always.items()})
                for trace, row in zip(joints[k], residuals[k], strict=False)
            ]
            bare = joints[k][0].load is PER_INERTIA
            text = formula(left, "N m/(kg m²)" if bare else "N m")
            if text:
                found[name] = f"missing torque ≈ {text}"
    return found


def what_is_left(trace: Trace, residual: Array, theta: Array, others: Mapping[str, Trace]) -> Left:
    """What a fitted servo leaves of one recording.

    Args:
        trace: The recording.
        residual: Simulated minus measured angle in rad, shape (T,) or longer.
        theta: Parameters of the servo, shape (P,).
        others: The same recording of other joints, by name.
    """
    kp, kd, latency = (float(x) for x in theta[:3])
    t, load = trace.t, trace.load
    besides = {name: np.interp(t, other.t, _position(other)) for name, other in others.items()}

    def state(position: Array) -> State:
        asked = kp * (np.interp(t - latency, t, trace.command) - position)
        return State(t - t[0], position, np.gradient(position, t), asked, besides)

    row = np.where(trace.used, residual[: t.size], 0.0)
    step = float(np.median(np.diff(t)))
    return Left(
        residual=row,
        counts=counting(trace, _LAGS),
        measured=state(_position(trace)),
        simulated=state(simulated(trace, theta[None])[0]),
        command=trace.command,
        servo=(kp, latency),
        response=response(load.inertia_kgm2, kd, kp + load.gravity_Nm, step),
    )


def _position(trace: Trace) -> Array:
    return smooth(trace.t, np.where(trace.used, trace.position, np.nan))
