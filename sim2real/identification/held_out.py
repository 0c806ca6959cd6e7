"""Errors on held-out data: every recording in turn, or the last quarter of a single one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.servo_problem import Servos, minimise, residual_angles, stacked
from sim2real.inference.least_squares import rms
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import BASE, INERTIA_LEFT_OUT
from sim2real.servo.rollout import LONGEST_SUBSTEP_S, rollout
from sim2real.servo.trace import Trace, split

_INERTIA, _GRAVITY = BASE.index("inertia_kgm2"), BASE.index("gravity_Nm")
_STEPS_PER_RADIAN = 16.0
"""Sub-steps per radian of the fastest mode."""


@dataclass(frozen=True)
class Unseen:
    """Residuals on held-out samples.

    Attributes:
        residuals: Simulated minus measured angles in rad, one array per fold.
        theta: Parameters fitted to the other samples of each fold, shape (folds, P).
    """

    residuals: tuple[Array, ...]
    theta: Array

    @property
    def rmse(self) -> float:
        """Root mean square error in rad."""
        return rms(self.residuals)


def folds(traces: Sequence[Trace]) -> list[tuple[list[Trace], list[Trace]]]:
    """Pairs of traces to fit and to score: each recording in turn, or the end of a single one."""
    if len(traces) > 1:
        return [([other for other in traces if other is not trace], [trace]) for trace in traces]
    fitted, scored, _ = split(traces, None)
    return [(fitted, scored)] if scored else []


def held_out(
    joints: Sequence[Sequence[Trace]],
    servos: Sequence[Servos],
    *,
    white: bool = True,
    device: str = "cpu",
) -> list[Unseen | None]:
    """Refit each servo without each fold, and compute its residuals there.

    Args:
        joints: Traces of each servo's joint.
        servos: Servos with the parameters fitted to all samples, each of one row.
        white: Whether the refits assume white noise, which gives better predictions if physics is
            missing from the model.
        device: Warp device.

    Returns:
        One entry per servo; None where nothing can be held out.
    """
    pairs = [(n, pair) for n, traces in enumerate(joints) for pair in folds(traces)]
    if not pairs:
        return [None for _ in joints]
    training = Batch([fitted for _, (fitted, _) in pairs], device, bounded=False)
    scoring = Batch([scored for _, (_, scored) in pairs], device)
    residuals: list[list[Array]] = [[] for _ in joints]
    theta: list[list[Array]] = [[] for _ in joints]
    for width in sorted({servos[n].columns.shape[1] for n, _ in pairs}):
        members = [k for k, (n, _) in enumerate(pairs) if servos[n].columns.shape[1] == width]
        start = stacked([servos[pairs[k][0]] for k in members])
        start = replace(start, joint=np.array(members, dtype=np.int32))
        fits = minimise(training, start, iterations=10, white=white)
        errors = residual_angles(scoring, fits)
        for k, error, row in zip(members, errors, fits.servos.theta, strict=True):
            n, (_, (trace,)) = pairs[k]
            residuals[n].append(error[0, : trace.used.size][trace.used])
            theta[n].append(row)
    return [
        Unseen(tuple(errors), np.array(rows)) if errors else None
        for errors, rows in zip(residuals, theta, strict=True)
    ]


def simulated(trace: Trace, theta: Array) -> Array:
    """Angles in rad of servos (N, P) on the command and load of a recording, shape (N, T)."""
    rows = np.array(theta)
    rows[:, _INERTIA], rows[:, _GRAVITY] = trace.load.inertia_kgm2, trace.load.gravity_Nm
    kp, kd = rows[0, :2]
    inertia = trace.load.inertia_kgm2 + rows[0, INERTIA_LEFT_OUT]
    fastest = max(float(np.sqrt(max(kp, 0.0) / inertia)), 0.5 * float(kd) / inertia, 1e-9)
    # A common sub-step, so that integration errors cancel in differences of servos.
    step = min(LONGEST_SUBSTEP_S, 1 / (_STEPS_PER_RADIAN * fastest))
    return rollout(rows, trace.t, trace.command, substep_s=step, threads=2)
