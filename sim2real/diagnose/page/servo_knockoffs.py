"""Knockoffs: made-up responses with the size and smoothness of real effects, but no cause.

A knockoff is the response to a real effect, delayed and with its sign flipped in random segments.
The held-out error with the best of them shows how much of an improvement chance alone would bring
(the idea of Barber, Candès, Annals of Statistics 43 (2015) 2055-2085).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.missing.screening import Candidate
from sim2real.identification.held_out import Side, Split, simulated
from sim2real.identification.servo_problem import Servos, variants
from sim2real.inference.folds import rms
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]


def changes(
    traces: Sequence[Trace], servo: Servos, candidates: Sequence[Candidate] = ()
) -> tuple[list[Array], list[Array]]:
    """Changes of a servo's angle by its free parameters and by effects, recording by recording.

    Args:
        traces: The joint's recordings.
        servo: One servo with F free parameters.
        candidates: Effects with S starts in total.

    Returns:
        Changes by one unit of each free parameter, (T, F) a recording, and by each start of each
        effect, (T, S) a recording.
    """
    own = variants(servo)
    free, scale = own.theta[0], own.scale[0, 1:]
    starts = [_with(free[0], c, start) for c in candidates for start in c.starts]
    rows = np.vstack([free, *(row[None] for row in starts)])
    F = scale.size
    by_parameters, by_effects = [], []
    for trace in traces:
        angle = simulated(trace, rows)
        change = (angle[1:] - angle[0]).T
        by_parameters.append(change[:, :F] * scale)
        by_effects.append(change[:, F:])
    return by_parameters, by_effects


def _with(row: Array, candidate: Candidate, start: Array) -> Array:
    changed = row.copy()
    changed[candidate.columns] = start
    return changed


def meaningless(
    response: Array,
    t: Array,
    rng: np.random.Generator,
    *,
    least_delay_s: float = 2.0,
    segment_s: tuple[float, float] = (1.5, 4.0),
    turn_s: float = 0.25,
) -> Array:
    """Responses to effects, delayed by a random time and with the sign of random segments flipped.

    A delay alone is not enough: where the command is periodic, a delayed response may still fit.

    Args:
        response: Change of the angle by each effect, shape (T, S).
        t: Times in s, shape (T,).
        rng: Source of the delay, the segments and the signs.
        least_delay_s: Shortest delay.
        segment_s: Range of the lengths of segments.
        turn_s: Time over which a sign flips.

    Returns:
        The knockoffs, shape (T, S).
    """
    step = float(np.median(np.diff(t)))
    away = max(1, min(round(least_delay_s / step), t.size // 4))
    delay = int(rng.integers(away, max(t.size - away, away + 1)))
    cuts = t[0] + np.cumsum(rng.uniform(*segment_s, size=int((t[-1] - t[0]) / segment_s[0]) + 1))
    # The weight passes through 0 where the delayed end meets the start, too, to avoid a jump.
    cuts = np.sort(np.append(cuts, t[min(delay, t.size - 1)]))
    segment = np.searchsorted(cuts, t)
    nearest = np.abs(t[:, None] - cuts[None]).min(axis=1)
    sign = rng.choice([-1.0, 1.0], size=cuts.size + 1)[segment]
    weight = sign * np.minimum(1.0, nearest / turn_s)
    return np.asarray(np.roll(response, delay, axis=0) * weight[:, None])


def best_knockoff(
    traces: Sequence[Trace],
    servo: Servos,
    effects: Sequence[Array],
    folds: Sequence[Split],
    rng: np.random.Generator,
    copies: int = 40,
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
        errors += _left_of_best(fold, changes(traces, refitted)[0], drawn)
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


def drop(columns: Array, taken: Array, along: Array) -> Array:
    """Decrease of a sum of squares by each column, fitted together with the columns of a basis.

    Args:
        columns: Shape (N, S).
        taken: Orthonormal basis of what is fitted anyway, shape (N, F).
        along: Inner product of each column with the residual, shape (S,).

    Returns:
        The decreases, shape (S,); 0 where the basis holds the column already.
    """
    cross = taken.T @ columns
    norm2 = np.einsum("ns,ns->s", columns, columns)
    seen2 = norm2 - np.einsum("fs,fs->s", cross, cross)
    there = seen2 > 1e-6 * norm2 + 1e-30
    return np.where(there, along**2 / np.maximum(seen2, 1e-300), 0.0)
