"""Levenberg-Marquardt on many least-squares problems in step, with the noise model fitted along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim2real.servo.batch import Batch, Problems

Array = NDArray[np.float64]
Whole = NDArray[np.int32]

DIFFERENCE = 2e-4
"""Step of the forward differences, in units."""
_SETTLED = 0.02
"""Gain in log-likelihood below which a step is not worth making."""
_LEAST, _MOST = 1e-6, 1e6
_LARGEST_STEP = 3.0
"""Largest step of a parameter, in units."""


@dataclass(frozen=True)
class Servos:
    """Servos with free parameters, each to be fitted to all recordings of one joint.

    Attributes:
        joint: Joint of the batch, shape (N,).
        theta: Parameters, shape (N, P).
        columns: Columns of the free ones, -1 where a servo has fewer, shape (N, F).
        unit: Their natural sizes, shape (N, F).
        low: Smallest values, shape (N, F).
        high: Largest values, shape (N, F).
    """

    joint: Whole
    theta: Array
    columns: Whole
    unit: Array
    low: Array
    high: Array

    def __getitem__(self, index: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Servos:
        """Some of them."""
        return Servos(*(value[index] for value in vars(self).values()))

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which places of ``columns`` hold a parameter, shape (N, F)."""
        return self.columns >= 0

    def values(self) -> Array:
        """Values of the free parameters in units, 0 where there is none, shape (N, F)."""
        taken = np.take_along_axis(self.theta, np.maximum(self.columns, 0), axis=1)
        return np.where(self.free, taken / self.unit, 0.0)

    def at(self, x: Array) -> Servos:
        """The servos with free parameters ``x`` (N, F), in units, kept within their bounds."""
        theta = self.theta.copy()
        row, place = np.nonzero(self.free)
        value = np.clip(x * self.unit, self.low, self.high)[row, place]
        theta[row, self.columns[row, place]] = value
        return replace(self, theta=theta)


@dataclass(frozen=True)
class Fits:
    """Where the search ended.

    Attributes:
        servos: The servos with fitted parameters.
        gram: Inner products of residual (0) and derivatives by the free parameters, by block,
            shape (N, B, 1 + F, 1 + F), in rad2 and units.
        count: Samples that count, shape (N,).
        autoregression: The noise model, shape (N, lags).
    """

    servos: Servos
    gram: Array
    count: Array
    autoregression: Array

    @property
    def error2(self) -> Array:
        """Sum of squared innovations in rad2, shape (N,)."""
        return np.asarray(self.gram[:, :, 0, 0].sum(axis=1))

    @property
    def loglikelihood(self) -> Array:
        """Logarithm of the likelihood, its variance and noise model at their best, shape (N,)."""
        return loglikelihood(self.error2, self.count)

    def __getitem__(self, index: NDArray[np.intp] | NDArray[np.bool_] | slice) -> Fits:
        """Some of them."""
        rest = (self.gram, self.count, self.autoregression)
        return Fits(self.servos[index], *(value[index] for value in rest))


def loglikelihood(error2: Array, count: Array) -> Array:
    """-n/2 log(error2 / n): Gaussian log-likelihood with the variance at its best, up to 1."""
    return np.asarray(-0.5 * count * np.log(np.maximum(error2, 1e-300) / count))


def minimise(
    batch: Batch,
    servos: Servos,
    *,
    iterations: int,
    blocks: int = 1,
    white: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Fits:
    """Fit all servos, each by its own Levenberg-Marquardt steps, one launch an iteration.

    The noise model of each servo is refitted at every point, which makes the sum of squared
    innovations the profile likelihood. Source: Marquardt, SIAM Journal on Applied Mathematics 11
    (1963) 431-441.

    Args:
        batch: The recordings.
        servos: Where to start.
        iterations: Most evaluations.
        blocks: Blocks of each recording for ``Fits.gram``.
        white: Whether to take the noise for white.
        progress: Called with the share that is done.
    """
    servos = servos.at(servos.values())
    N, F = servos.columns.shape
    best = servos.values()
    damping = np.full(N, 1e-3)
    gram, model, count = None, None, np.ones(N)
    trial, active = best.copy(), np.arange(N)
    for iteration in range(iterations):
        now = servos[active].at(trial[active])
        noise = np.zeros((now.joint.size, batch.lags)) if white else None
        seen = batch.evaluate(variants(now), blocks=blocks, autoregression=noise)
        if gram is None or model is None:
            gram, model, count = seen.gram, seen.autoregression, seen.count
            better = np.ones(N, dtype=bool)
        else:
            better = seen.gram[:, :, 0, 0].sum(axis=1) < gram[active, :, 0, 0].sum(axis=1)
            won = active[better]
            gram[won], model[won] = seen.gram[better], seen.autoregression[better]
        won, lost = active[better], active[~better]
        best[won] = now.values()[better]
        damping[won] = np.maximum(damping[won] / 5, _LEAST)
        damping[lost] *= 8
        step, gain = _step(servos[active], gram[active].sum(axis=1), best[active], damping[active])
        worth = (gain * count[active] > _SETTLED) & (damping[active] < _MOST)
        trial[active] = best[active] + step
        active = active[worth]
        progress((iteration + 1) / iterations)
        if not active.size:
            break
    assert gram is not None and model is not None
    return Fits(servos.at(best), gram, count, model)


def variants(servos: Servos) -> Problems:
    """Each servo and, for every free parameter, the servo with a little more of it."""
    N, F = servos.columns.shape
    theta = np.repeat(servos.theta[:, None], 1 + F, axis=1)
    row, place = np.nonzero(servos.free)
    column = servos.columns[row, place]
    value = servos.theta[row, column]
    # Towards the inside of the bounds.
    size = DIFFERENCE * servos.unit[row, place]
    size = np.where(value + size > servos.high[row, place], -size, size)
    theta[row, 1 + place, column] = value + size
    scale = np.zeros((N, 1 + F))
    scale[row, 1 + place] = servos.unit[row, place] / size
    return Problems(servos.joint, theta, scale)


def _step(servos: Servos, gram: Array, x: Array, damping: Array) -> tuple[Array, Array]:
    """Next step of each problem, shape (N, F), and its expected gain in log-likelihood a sample."""
    error2, slope, normal = gram[:, 0, 0], gram[:, 1:, 0], gram[:, 1:, 1:]
    held = ~servos.free
    with np.errstate(invalid="ignore"):
        low, high = servos.low / servos.unit, servos.high / servos.unit
    margin = 1e-9 * (high - low)
    held |= (x <= low + margin) & (slope > 0)
    held |= (x >= high - margin) & (slope < 0)
    diagonal = np.einsum("nff->nf", normal)
    floor = 1e-12 * diagonal.max(axis=1, initial=0.0, keepdims=True) + 1e-300
    held |= diagonal <= floor
    moving = ~held
    matrix = normal * (moving[:, :, None] & moving[:, None])
    size = np.where(moving, diagonal * (1 + damping[:, None]), 1.0)
    np.einsum("nff->nf", matrix)[...] = size
    step = np.linalg.solve(matrix, np.where(moving, -slope, 0.0)[:, :, None])[:, :, 0]
    longest = np.abs(step).max(axis=1, initial=0.0, keepdims=True)
    step *= np.minimum(1.0, _LARGEST_STEP / np.maximum(longest, 1e-300))
    step = np.clip(x + step, low, high) - x
    change = 2 * np.einsum("nf,nf->n", slope, step)
    change += np.einsum("nf,nfg,ng->n", step, normal, step)
    gain: Array = -0.5 * change / np.maximum(error2, 1e-300)
    return np.asarray(step, dtype=np.float64), gain
