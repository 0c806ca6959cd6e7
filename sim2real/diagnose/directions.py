"""How a little of each effect, and of each free parameter, would move the angles of one fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.candidates import Candidate
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.problem import Servos, variants
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, rollout
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

_STEPS_PER_RADIAN = 16.0
_INERTIA, _GRAVITY = BASE.index("inertia_kgm2"), BASE.index("gravity_Nm")
_MORE_INERTIA = COLUMNS.index("unmodelled_inertia.inertia_kgm2")


@dataclass(frozen=True)
class Directions:
    """One fit of one joint, and what it could be changed by, recording by recording.

    Attributes:
        residual: Simulated minus measured angle in rad, 0 where none was measured, (T,) each.
        taken: Changes of the angle by the free parameters, in rad a unit, (T, F) each.
        effects: Changes of the angle by the starts of all candidates, in rad, (T, S) each.
        candidate: Index of each start's candidate, shape (S,).
    """

    residual: tuple[Array, ...]
    taken: tuple[Array, ...]
    effects: tuple[Array, ...]
    candidate: NDArray[np.intp]


def directions(
    traces: Sequence[Trace], servo: Servos, candidates: Sequence[Candidate] = ()
) -> Directions:
    """Simulate a servo, and it with a little more of everything.

    Args:
        traces: The joint's recordings.
        servo: One servo.
        candidates: The effects.
    """
    own = variants(servo)
    free, scale = own.theta[0], own.scale[0, 1:]
    starts = [_with(free[0], c, start) for c in candidates for start in c.starts]
    rows = np.vstack([free, *(row[None] for row in starts)])
    F = scale.size
    residual, taken, effects = [], [], []
    for trace in traces:
        angle = simulated(trace, rows)
        change = (angle[1:] - angle[0]).T
        residual.append(np.where(trace.used, angle[0] - trace.position, 0.0))
        taken.append(change[:, :F] * scale)
        effects.append(change[:, F:])
    label = np.repeat(np.arange(len(candidates)), [len(c.starts) for c in candidates]).astype(int)
    return Directions(tuple(residual), tuple(taken), tuple(effects), label)


def simulated(trace: Trace, theta: Array) -> Array:
    """Angles in rad of servos (N, P) on the command and load of a recording, shape (N, T)."""
    rows = np.array(theta)
    rows[:, _INERTIA], rows[:, _GRAVITY] = trace.load.inertia_kgm2, trace.load.gravity_Nm
    kp, kd = rows[0, :2]
    inertia = trace.load.inertia_kgm2 + rows[0, _MORE_INERTIA]
    fastest = max(float(np.sqrt(max(kp, 0.0) / inertia)), 0.5 * float(kd) / inertia, 1e-9)
    # One length for all, or differences between them would be of the integration.
    step = min(LONGEST_SUBSTEP_S, 1 / (_STEPS_PER_RADIAN * fastest))
    angle = rollout(rows, trace.t, trace.command[:, None], substep_s=step, threads=2)
    return np.ascontiguousarray(angle[:, :, 0])


def _with(row: Array, candidate: Candidate, start: Array) -> Array:
    changed = row.copy()
    changed[candidate.columns] = start
    return changed
