"""What the best of many meaningless effects is worth on data that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decoys import meaningless
from sim2real.diagnose.directions import directions
from sim2real.diagnose.splits import Simulated, Split, rms
from sim2real.servo.problem import Servos
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

COPIES = 40
"""Decoys of each start of each effect, for all folds together."""


def best_decoy(
    traces: Sequence[Trace],
    servo: Servos,
    effects: Sequence[Array],
    folds: Sequence[Split],
    rng: np.random.Generator,
    copies: int = COPIES,
) -> float:
    """Held-out error of the plain servo with the best decoy, rad.

    In every fold the decoy that explains most of the fitted side is chosen there, its strength and
    the plain servo's parameters fitted there along with it, to first order, by least squares.

    Args:
        traces: The joint's recordings.
        servo: The plain servo, with its free parameters.
        effects: Changes of its angle by the starts of all effects, (T, S) a recording.
        folds: Its refits.
        rng: For the decoys.
        copies: Decoys of each start of each effect, for all folds together.
    """
    drawn = [
        [meaningless(x, t.t, rng) for x, t in zip(effects, traces, strict=True)]
        for _ in range(max(copies // len(folds), 4))
    ]
    errors: list[Array] = []
    for fold in folds:
        refitted = replace(servo, theta=fold.theta[None])
        errors += _left(fold, directions(traces, refitted).taken, drawn)
    return rms(errors)


def _left(fold: Split, bent: Sequence[Array], drawn: Sequence[Sequence[Array]]) -> list[Array]:
    residual = np.concatenate([one.residual for one in fold.fitted])
    taken = _rows(bent, fold.fitted)
    basis, _ = np.linalg.qr(taken)
    residual = residual - basis @ (basis.T @ residual)
    most, chosen = 0.0, None
    for decoys in drawn:
        columns = _rows(decoys, fold.fitted)
        cross = basis.T @ columns
        norm2 = np.einsum("ns,ns->s", columns, columns)
        seen2 = norm2 - np.einsum("fs,fs->s", cross, cross)
        there = seen2 > 1e-6 * norm2 + 1e-30
        drop = np.where(there, (residual @ columns) ** 2 / np.maximum(seen2, 1e-300), 0.0)
        best = int(drop.argmax())
        if drop[best] > most:
            most, chosen = float(drop[best]), (decoys, best)
    if chosen is None:
        return [one.residual for one in fold.scored]
    decoys, best = chosen
    design = np.column_stack([taken, _rows(decoys, fold.fitted)[:, best]])
    size = np.sqrt((design**2).sum(axis=0)) + 1e-300
    before = np.concatenate([one.residual for one in fold.fitted])
    change = np.linalg.lstsq(design / size, -before, rcond=1e-8)[0] / size
    after = []
    for one in fold.scored:
        moved = np.column_stack([_rows(bent, [one]), _rows(decoys, [one])[:, best]])
        after.append(one.residual + moved @ change)
    return after


def _rows(columns: Sequence[Array], sides: Sequence[Simulated]) -> Array:
    """Rows of the samples that are used on one side, shape (N, ...)."""
    return np.concatenate([columns[one.recording][one.trace.used] for one in sides])
