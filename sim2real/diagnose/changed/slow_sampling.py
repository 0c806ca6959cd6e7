"""Servos that are sampled so slowly that they are mostly seen at rest: where they came to rest.

What such a recording shows of a motion is a sample or two of it; what it shows well is the angle at
which the servo stays, given its set-point and the side from which it came. The references say that
without a model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decision import DECISION
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


def is_slow(traces: Sequence[Trace]) -> bool:
    """Whether these recordings show a servo mostly at rest."""
    return (
        float(np.median(np.concatenate([np.diff(trace.t) for trace in traces])))
        > DECISION.change.slow_sampling_s
    )


def beside_rest(
    traces: Sequence[Trace], references: int, step_rad: float
) -> tuple[list[Array], float]:
    """Angles less those at which the references came to rest, in rad.

    Args:
        traces: The recordings of one joint, the references first.
        references: How many are references.
        step_rad: Step of the joint's sensor.

    Returns:
        For each recording what differs from the mean of the other references after the same
        set-point and from the same side, NaN in motion and where no reference can say, shape (T,);
        and by how much readings of one reference differ after one set-point, mean square in rad2.
    """
    rests = [_resting(trace, step_rad) for trace in traces]
    levels: list[dict[tuple[float, float], Array]] = []
    for trace, (still, side) in zip(traces[:references], rests, strict=False):
        keys = list(zip(_rounded(trace.command), side, strict=True))
        known: dict[tuple[float, float], list[float]] = {}
        for k in np.flatnonzero(still):
            known.setdefault(keys[k], []).append(float(trace.position[k]))
        levels.append({key: np.array(seen) for key, seen in known.items()})
    spread = [seen - seen.mean() for one in levels for seen in one.values()]
    within = float(np.mean(np.concatenate(spread) ** 2)) if spread else 0.0
    beside = []
    for r, (trace, (still, side)) in enumerate(zip(traces, rests, strict=True)):
        left = np.full(trace.t.size, np.nan)
        others = [one for q, one in enumerate(levels) if q != r]
        command = _rounded(trace.command)
        for k in np.flatnonzero(still):
            same = [
                np.concatenate(found)
                for one in others
                if (found := [x for key, x in one.items() if _alike(key, (command[k], side[k]))])
            ]
            if same:
                left[k] = trace.position[k] - np.mean([seen.mean() for seen in same])
        beside.append(left)
    return beside, within


def _rounded(command: Array) -> list[float]:
    return [
        float(x)
        for x in np.round(command / DECISION.change.same_set_point_rad)
        * DECISION.change.same_set_point_rad
    ]


def _alike(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two rests have one set-point and sides that may be the same; 0 is not known."""
    return (
        abs(one[0] - other[0]) < 2 * DECISION.change.same_set_point_rad and one[1] * other[1] >= 0
    )


def _resting(trace: Trace, step_rad: float) -> tuple[NDArray[np.bool_], Array]:
    """Which samples are at rest, and from which side each came, 0 where that is not known."""
    change = np.diff(trace.command, prepend=trace.command[:1])
    recent = (
        np.convolve(change != 0, np.ones(DECISION.change.settling_samples + 1))[: change.size] > 0
    )
    steps = np.abs(np.diff(trace.position))
    quiet = steps < DECISION.change.rest_steps * max(step_rad, 1e-9)
    still = trace.used & ~recent & np.append(True, quiet) & np.append(quiet, True)
    still[: DECISION.change.settling_samples] = False
    last = np.maximum.accumulate(np.where(change != 0, np.arange(change.size), 0))
    return still, np.sign(change[last])
