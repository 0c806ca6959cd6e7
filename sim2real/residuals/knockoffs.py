"""Knockoffs of what effects do to a servo's angle: see ``inference.knockoffs``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.inference.holdout import rms
from sim2real.inference.knockoffs import Directions, drop, meaningless
from sim2real.residuals.holdout import Side, Split, simulated
from sim2real.residuals.problem import Servos, variants
from sim2real.residuals.screen import Candidate
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

COPIES = 40
"""Knockoffs of each start of each effect, for all folds together."""


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
    t, used = tuple(trace.t for trace in traces), tuple(trace.used for trace in traces)
    return Directions(t, used, tuple(residual), tuple(taken), tuple(effects), label)


def _with(row: Array, candidate: Candidate, start: Array) -> Array:
    changed = row.copy()
    changed[candidate.columns] = start
    return changed


def best_knockoff(
    traces: Sequence[Trace],
    servo: Servos,
    effects: Sequence[Array],
    folds: Sequence[Split],
    rng: np.random.Generator,
    copies: int = COPIES,
) -> float:
    """Held-out error of the plain servo with the best knockoff, rad.

    In every fold the knockoff that explains most of the fitted side is chosen there, its strength
    and the plain servo's parameters fitted there along with it, to first order, by least squares.

    Args:
        traces: The joint's recordings.
        servo: The plain servo, with its free parameters.
        effects: Changes of its angle by the starts of all effects, (T, S) a recording.
        folds: Its refits.
        rng: For the knockoffs.
        copies: Knockoffs of each start of each effect, for all folds together.
    """
    drawn = [
        [meaningless(x, t.t, rng) for x, t in zip(effects, traces, strict=True)]
        for _ in range(max(copies // len(folds), 4))
    ]
    errors: list[Array] = []
    for fold in folds:
        refitted = replace(servo, theta=fold.theta[None])
        errors += _left_of_best(fold, directions(traces, refitted).taken, drawn)
    return rms(errors)


def _left_of_best(
    fold: Split, bent: Sequence[Array], drawn: Sequence[Sequence[Array]]
) -> list[Array]:
    residual = np.concatenate([one.residual for one in fold.fitted])
    taken = _rows(bent, fold.fitted)
    basis, _ = np.linalg.qr(taken)
    residual = residual - basis @ (basis.T @ residual)
    most, chosen = 0.0, None
    for knockoffs in drawn:
        columns = _rows(knockoffs, fold.fitted)
        lower = drop(columns, basis, residual @ columns)
        best = int(lower.argmax())
        if lower[best] > most:
            most, chosen = float(lower[best]), (knockoffs, best)
    if chosen is None:
        return [one.residual for one in fold.scored]
    knockoffs, best = chosen
    design = np.column_stack([taken, _rows(knockoffs, fold.fitted)[:, best]])
    size = np.sqrt((design**2).sum(axis=0)) + 1e-300
    before = np.concatenate([one.residual for one in fold.fitted])
    change = np.linalg.lstsq(design / size, -before, rcond=1e-8)[0] / size
    after = []
    for one in fold.scored:
        moved = np.column_stack([_rows(bent, [one]), _rows(knockoffs, [one])[:, best]])
        after.append(one.residual + moved @ change)
    return after


def _rows(columns: Sequence[Array], sides: Sequence[Side]) -> Array:
    """Rows of the samples that are used on one side, shape (N, ...)."""
    return np.concatenate([columns[one.recording][one.trace.used] for one in sides])
