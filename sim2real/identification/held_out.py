"""Errors on held-out data: every recording in turn, or the last quarter of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.servo_problem import Servos, minimise, residual_angles, stacked
from sim2real.inference.least_squares import rms
from sim2real.servo.batch import Batch
from sim2real.servo.trace import Trace, split


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


def folds(traces: Sequence[Trace], *, ends: bool = False) -> list[tuple[list[Trace], list[Trace]]]:
    """Pairs of traces to fit and to score: each recording in turn, or the end of a single one.

    Args:
        traces: The recordings.
        ends: Whether of several recordings the end of each is held out, instead of all of it.
    """
    if len(traces) > 1 and not ends:
        return [([other for other in traces if other is not trace], [trace]) for trace in traces]
    parts = [(trace, *split([trace], None)[:2]) for trace in traces]
    return [
        ([*(other for other in traces if other is not trace), *fitted], scored)
        for trace, fitted, scored in parts
        if scored
    ]


def held_out(
    joints: Sequence[Sequence[Trace]],
    servos: Sequence[Servos],
    *,
    white: bool = True,
    ends: Sequence[bool] | None = None,
    device: str = "cpu",
) -> list[Unseen | None]:
    """Refit each servo without each fold, and compute its residuals there.

    Args:
        joints: Traces of each servo's joint.
        servos: Servos with the parameters fitted to all samples, each of one row.
        white: Whether the refits assume white noise, which gives better predictions if physics is
            missing from the model.
        ends: For each servo, whether only the ends of its recordings are held out; by default
            not.
        device: Warp device.

    Returns:
        One entry per servo; None where nothing can be held out.
    """
    only_ends = ends or [False] * len(joints)
    pairs = [
        (n, pair) for n, traces in enumerate(joints) for pair in folds(traces, ends=only_ends[n])
    ]
    if not pairs:
        return [None for _ in joints]
    training = Batch([fitted for _, (fitted, _) in pairs], device, bounded=False)
    scoring = Batch([scored for _, (_, scored) in pairs], device)
    residuals: list[list[Array]] = [[] for _ in joints]
    theta: list[list[Array]] = [[] for _ in joints]
    for width in sorted({servos[n].columns.shape[1] for n, _ in pairs}):
        members = [k for k, (n, _) in enumerate(pairs) if servos[n].columns.shape[1] == width]
        start = stacked([servos[pairs[k][0]] for k in members]).of_joints(members)
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
