"""References and case fitted together: one servo for all, but for what is free in the case alone.

Levenberg-Marquardt on the profile likelihood, each recording with a variance of its own (Marquardt,
SIAM Journal on Applied Mathematics 11 (1963) 431-441).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.servo.batch import Batch
from sim2real.servo.problem import Servos, variants

Array = NDArray[np.float64]
Whole = NDArray[np.int32]

_ITERATIONS = 15
_SETTLED = 0.02
_LEAST, _MOST = 1e-6, 1e6
_LARGEST_STEP = 3.0


@dataclass(frozen=True)
class Own:
    """What the case has to itself.

    Attributes:
        columns: Columns of its K parameters, shape (K,).
        value: Where they start, shape (K,).
        unit: Their natural sizes, shape (K,).
        low: Their smallest values, shape (K,).
        high: Their largest values, shape (K,).
    """

    columns: Whole
    value: Array
    unit: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Apart:
    """Where the fits ended, one for each set of own parameters.

    Attributes:
        loglikelihood: Its logarithm, up to a constant, shape (H,).
        left: Sum of squared innovations in the case, rad2, shape (H,).
        theta: Parameters of the case, shape (H, P).
    """

    loglikelihood: Array
    left: Array
    theta: Array


def fitted_apart(batch: Batch, servo: Servos, noise: Array, owns: Sequence[Own]) -> Apart:
    """Fit the shared servo together with each set of the case's own parameters.

    Args:
        batch: The references as its first joint and the case as its second.
        servo: Where the shared servo starts, of one row.
        noise: The noise model, shape (1, lags).
        owns: What is free in the case alone, a fit each; it may be nothing.
    """
    H, F = len(owns), servo.columns.shape[1]
    before, case = _both(servo, owns)
    x = case.values()
    # Of a parameter that the case has to itself the shared value is the references' alone.
    x[:, :F] = before.values()
    moving = case.free.copy()
    moving[:, :F] = True
    bounds = (case.low / case.unit, case.high / case.unit)
    model = np.repeat(noise, H, axis=0)
    now = _point(batch, before.at(x[:, :F]), case.at(x), model)
    damping = np.full(H, 1e-3)
    for _ in range(_ITERATIONS):
        trial = _next(x, now, damping, moving, bounds)
        then = _point(batch, before.at(trial[:, :F]), case.at(trial), model)
        won = then.score > now.score
        going = np.where(won, then.score - now.score > _SETTLED, damping < _MOST)
        x = np.where(won[:, None], trial, x)
        now = now.where(won, then)
        damping = np.where(won, np.maximum(damping / 5, _LEAST), damping * 8)
        if not going.any():
            break
    # What the case shares stands in its row, too, but for what it has to itself.
    shared = before.at(x[:, :F]).theta
    mine = case.at(x).theta
    own = np.zeros(mine.shape, dtype=bool)
    for h, one in enumerate(owns):
        own[h, one.columns] = True
    return Apart(now.score, now.left, np.where(own, mine, shared))


@dataclass(frozen=True)
class _Point:
    """Profile likelihood, its slope and curvature, and what is left of the case."""

    score: Array
    slope: Array
    normal: Array
    left: Array

    def where(self, won: NDArray[np.bool_], then: _Point) -> _Point:
        """The other's rows where it has won."""
        pairs = zip(vars(then).values(), vars(self).values(), strict=True)
        return _Point(
            *(np.where(won.reshape(-1, *[1] * (new.ndim - 1)), new, old) for new, old in pairs)
        )


def _point(batch: Batch, before: Servos, case: Servos, model: Array) -> _Point:
    H, size = case.columns.shape
    score, slope, normal = np.zeros(H), np.zeros((H, size)), np.zeros((H, size, size))
    left = np.zeros(H)
    ends = np.concatenate([[0], np.cumsum(batch.recordings)])
    for part, servos in enumerate((before, case)):
        count = batch.samples[ends[part] : ends[part + 1]].astype(np.float64)
        seen = batch.evaluate(variants(servos), autoregression=model)
        gram = seen.gram[:, : count.size]
        energy = gram[:, :, 0, 0]
        free = slice(gram.shape[2] - 1)
        weight = count / energy
        score -= 0.5 * np.log(energy) @ count
        slope[:, free] += np.einsum("hr,hrf->hf", weight, gram[:, :, 1:, 0])
        normal[:, free, free] += np.einsum("hr,hrfg->hfg", weight, gram[:, :, 1:, 1:])
        left = energy.sum(axis=1)
    lost = ~np.isfinite(score)
    score[lost], left[lost] = -np.inf, np.inf
    slope[lost], normal[lost] = 0.0, np.eye(size)
    return _Point(score, slope, normal, left)


def _next(
    x: Array, at: _Point, damping: Array, moving: NDArray[np.bool_], bounds: tuple[Array, Array]
) -> Array:
    """The next step of each fit, shape (H, F + K)."""
    diagonal = np.einsum("hff->hf", at.normal)
    free = moving & (diagonal > 1e-12 * diagonal.max(axis=1, keepdims=True))
    matrix = at.normal * (free[:, :, None] & free[:, None])
    np.einsum("hff->hf", matrix)[...] = np.where(free, diagonal * (1 + damping[:, None]), 1.0)
    step = np.linalg.solve(matrix, np.where(free, -at.slope, 0.0)[:, :, None])[:, :, 0]
    longest = np.abs(step).max(axis=1, keepdims=True)
    step *= np.minimum(1.0, _LARGEST_STEP / np.maximum(longest, 1e-300))
    low, high = bounds
    return np.asarray(np.where(moving, np.clip(x + step, low, high), x))


def _both(servo: Servos, owns: Sequence[Own]) -> tuple[Servos, Servos]:
    """The references' servo and the case's, for each set of own parameters."""
    H, F = len(owns), servo.columns.shape[1]
    K = max(own.columns.size for own in owns)
    before = servo[np.zeros(H, dtype=np.intp)]
    before = replace(before, joint=np.zeros(H, dtype=np.int32))
    pad = ((0, 0), (0, K))
    columns = np.pad(before.columns, pad, constant_values=-1)
    unit = np.pad(before.unit, pad, constant_values=1.0)
    low, high = np.pad(before.low, pad), np.pad(before.high, pad)
    theta = before.theta.copy()
    for h, own in enumerate(owns):
        some = slice(F, F + own.columns.size)
        columns[h, :F][np.isin(columns[h, :F], own.columns)] = -1
        columns[h, some], theta[h, own.columns] = own.columns, own.value
        unit[h, some], low[h, some], high[h, some] = own.unit, own.low, own.high
    joint = np.ones(H, dtype=np.int32)
    return before, Servos(joint, theta, columns, unit, low, high)
