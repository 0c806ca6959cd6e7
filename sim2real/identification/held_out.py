"""Errors on held-out data: segments of all recordings in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.servo_problem import (
    Servos,
    minimise_robustly,
    residual_angles,
    stacked,
)
from sim2real.inference.least_squares import rms
from sim2real.servo.batch import Batch
from sim2real.servo.trace import Trace

FOLDS = 4
"""Number of folds."""
_SEGMENTS = 2
"""Segments of a recording in each fold."""


@dataclass(frozen=True)
class Unseen:
    """Residuals on held-out samples."""

    residuals: tuple[Array, ...]  # simulated minus measured angles in rad, one array per fold
    theta: Array  # parameters fitted to the other samples of each fold, shape (folds, P)
    # residuals over their ``Trace.error_ratio``; none where they are the same
    standardised: tuple[Array, ...] = ()

    @property
    def rmse(self) -> float:
        """Root mean square error in rad."""
        return rms(self.residuals)

    @property
    def error(self) -> float:
        """Root mean square of the standardised error in rad."""
        return rms(self.standardised or self.residuals)

    def clearly_better(self, other: Unseen, least: float) -> bool:
        """Whether errors are below another servo's by a share ``least`` and a standard error.

        The standard error is that over the folds, as in the one-standard-error rule for the simpler
        of two models: Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, 2nd ed.
        (Springer 2009), section 7.10.
        """
        gains = [
            np.log(rms([theirs]) / rms([own]))
            for own, theirs in zip(self.residuals, other.residuals, strict=True)
        ]
        beyond = np.std(gains) / np.sqrt(max(len(gains) - 1, 1)) - np.log1p(-least)
        return bool(np.mean(gains) > beyond)


def folds(traces: Sequence[Trace], *, whole: bool = False) -> list[tuple[list[Trace], list[Trace]]]:
    """Pairs of traces to fit and to score, which differ in the samples that are ``used``.

    Each recording is cut into segments of equal length, of which every fold scores some: what only
    one recording shows, such as a limit of speed, is then in the data of every fit. None where the
    samples outside a segment show no motion. With ``whole``, every fold scores one recording of
    several, as a motion that was never seen.
    """
    if whole:
        return [([x for x in traces if x is not one], [one]) for one in traces]
    pairs = []
    for fold in range(FOLDS):
        fitted, scored = [], []
        for trace in traces:
            share = (trace.t - trace.t[0]) / max(trace.duration_s, 1e-9)
            segment = np.minimum((share * FOLDS * _SEGMENTS).astype(int), FOLDS * _SEGMENTS - 1)
            held = segment % FOLDS == fold
            fitted.append(replace(trace, used=trace.used & ~held))
            scored.append(replace(trace, used=trace.used & held))
        moves = any(replace(t, position=t.measured).moves() for t in fitted)
        if moves and any(t.used.any() for t in scored):
            pairs.append((fitted, scored))
    return pairs


def held_out(
    joints: Sequence[Sequence[Trace]], servos: Sequence[Servos], *, whole: bool = False
) -> list[Unseen | None]:
    """Refit each servo without each fold, and compute its residuals there.

    Refits are robust and assume white noise: a free noise model takes what is missing from a model
    for noise, and predicts worse. They start from ``servos`` with the parameters fitted to all
    traces of their ``joints``, each of one row. None for those of which nothing can be held out.
    """
    pairs = [(n, pair) for n, traces in enumerate(joints) for pair in folds(traces, whole=whole)]
    if not pairs:
        return [None for _ in joints]
    start = stacked([servos[n] for n, _ in pairs]).of_joints(range(len(pairs)))
    fits = minimise_robustly([fitted for _, (fitted, _) in pairs], start)
    scoring = Batch([scored for _, (_, scored) in pairs], white=True)
    residuals, standard, theta = (list[list[Array]]([] for _ in joints) for _ in range(3))
    errors = residual_angles(scoring, fits)
    for (n, (_, scored)), error, row in zip(pairs, errors, fits.servos.theta, strict=True):
        left = [(t, e[: t.t.size]) for t, e in zip(scored, error, strict=False)]
        residuals[n].append(np.concatenate([e[t.used] for t, e in left]))
        standard[n].append(np.concatenate([(e / t.error_ratio)[t.used] for t, e in left]))
        theta[n].append(row)
    return [
        Unseen(tuple(plain), np.array(rows), tuple(relative)) if plain else None
        for plain, rows, relative in zip(residuals, theta, standard, strict=True)
    ]
