"""Quantization step and noise standard deviation of a measured angle."""

from itertools import pairwise
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import chdtri, logsumexp, ndtr

from sim2real.arrays import Array

ABOVE_NOISE = 2.0
"""Multiple of the noise above which the error of a model is reported."""
BLOCK = 10  # samples over which a joint at rest may drift along a line
_FEWEST_BLOCKS = 4  # 32 degrees of freedom: a relative error of the standard deviation of 12 %
_MOVING_BLOCK = 20  # samples of a block of a moving joint
_FINEST_RAD = 5e-6  # smaller steps are not distinguishable from rounding in the file
_COARSEST_RAD = 0.05  # 126 counts a turn
_STILL_RAD = 1e-4  # largest change of a constant command


def quantization_step(position: Array) -> float:
    """Step in rad of the grid on which all positions lie; 0.0 if none between 5e-6 and 0.05 rad.

    The step is the greatest common divisor of the gaps between the visited levels, up to the
    rounding of the file. It is accepted if the gaps would not fit such a grid by chance, or if
    most levels are visited repeatedly, which does not happen for a continuous signal.

    ``position``: measured angles in rad, shape (T,); NaN where a sample is missing.
    """
    levels, visits = np.unique(np.round(position[np.isfinite(position)], 9), return_counts=True)
    distinct = np.diff(levels) > 1e-7  # one level may differ in its last binary digits
    if not distinct.any():
        return 0.0
    visits = np.add.reduceat(visits, np.flatnonzero(np.r_[True, distinct]))
    levels = levels[np.r_[True, distinct]]
    gaps = np.diff(levels)
    # The power of ten to which the angles were printed, at least 1e-6.
    exact = (np.allclose(levels, np.round(levels, n), rtol=0, atol=1e-9) for n in range(2, 6))
    printed = 10.0 ** -next((n for n, fits in enumerate(exact, 2) if fits), 6)
    repeated = int(np.sum(visits > 1)) >= max(2, levels.size / 2)
    candidates = 20
    for divisor in range(1, candidates + 1):
        step = _refined(gaps, float(gaps.min()) / divisor)
        error = float(np.abs(gaps - step * np.round(gaps / step)).max())
        if step < _FINEST_RAD or error > min(1.1 * printed, step / 5):
            continue
        chance = min(1.0, (2 * error + printed) / step)  # that a gap of any length fits
        if repeated or (gaps.size - 1) * np.log(chance) < np.log(1e-4 / candidates):
            return step if step <= _COARSEST_RAD else 0.0
    return 0.0


def _refined(gaps: Array, step: float) -> float:
    """``step`` refined on increasingly long ``gaps`` (N,), so that counts are exact."""
    for reach in (1.5, 4.5, 16.5, 64.5, np.inf):
        near = gaps[gaps < reach * step]
        counts = np.round(near / step).sum()
        if counts > 0:
            step = float(near.sum() / counts)
    return step


def noise_floor(t: Array, command: Array, position: Array) -> float:
    """Standard deviation of the measurement noise, including quantization.

    It is estimated from segments where the command is constant and the joint has settled: variance
    about a line over every 10 samples, which excludes slow drift and slower noise. If it is below
    about half a step, the quantization error of a joint at rest is constant and its samples carry
    little information on it; the noise before quantization is then estimated by maximum
    likelihood and ``step**2 / 12`` added (the variance of a uniform error: B. Widrow,
    I. Kollár, "Quantization Noise", Cambridge University Press, 2008). Without such segments,
    ``difference_noise`` is used.

    Times in s, set-points and angles in rad, NaN where missing, are of shape (T,). The result is at
    least ``step / sqrt(12)``; 0.0 if it cannot be estimated.
    """
    step = quantization_step(position)
    measured = np.isfinite(position)
    t, command, position = t[measured], command[measured], position[measured]
    blocks, variance = _quiet_blocks(t, command, position, step)
    sd = difference_noise(t, position)
    if len(blocks) >= _FEWEST_BLOCKS:
        at_rest = float(np.sqrt(variance.mean()))
        if at_rest < 0.6 * step:
            sd = float(np.hypot(_noise_before_rounding(blocks / step) * step, step / np.sqrt(12)))
        elif sd < 0.6 * step or at_rest < 2 * sd:  # otherwise it moves at constant command
            sd = at_rest
    return max(sd, step / float(np.sqrt(12)))


def difference_noise(t: Array, position: Array) -> float:
    """Standard deviation of the noise on a moving joint, from differences of high order.

    Motion can only increase ``divided_differences``, so the smallest estimate of orders 2 to 5 is
    used, each from the fifth of blocks of 20 with least variance.

    Times in s and angles in rad, none missing, are of shape (T,). 0.0 for fewer than 6 samples.
    """
    if t.size < 6:
        return 0.0
    estimates = []
    for order in range(2, 6):
        square = divided_differences(t, position, order) ** 2
        size = min(_MOVING_BLOCK, square.size)
        blocks = square[: square.size // size * size].reshape(-1, size).mean(axis=1)
        # Neighbouring differences share samples, which reduces the degrees of freedom.
        free = size * comb(2 * order, order) ** 2 / comb(4 * order, 2 * order)
        estimates.append(_quietest(blocks, free))
    return float(np.sqrt(min(estimates)))


def divided_differences(t: Array, position: Array, order: int) -> Array:
    """Divided differences of ``order + 1`` neighbouring samples, with weights of unit norm.

    They cancel polynomial motion of degree below ``order`` and keep the variance of white noise
    (difference-based estimation: P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77, 1990,
    pp. 521-528). Times in s and angles in rad are of shape (T,), the result (T - order,).
    """
    times, angles = (sliding_window_view(x, order + 1) for x in (t, position))
    unit = times[:, 1:2] - times[:, :1]
    gaps = [(times[:, k : k + 1] - np.delete(times, k, axis=1)) / unit for k in range(order + 1)]
    weight = 1 / np.stack([gap.prod(axis=1) for gap in gaps], axis=1)
    weight /= np.linalg.norm(weight, axis=1, keepdims=True)
    return np.asarray(np.sum(weight * (angles - angles[:, :1]), axis=1))


def _quiet_blocks(t: Array, command: Array, position: Array, step: float) -> tuple[Array, Array]:
    """Positions (N, BLOCK) of a joint at rest and their variances (N,) about a line."""
    edges = [0]  # of the segments of constant command
    for k in np.flatnonzero(np.diff(command)) + 1:
        if abs(command[k] - command[edges[-1]]) > _STILL_RAD:
            edges.append(int(k))
    edges.append(command.size)
    ends = [np.arange(b, a + BLOCK - 1, -BLOCK) for a, b in pairwise(edges)]  # latest, most settled
    index = np.concatenate(ends)[:, None] + np.arange(-BLOCK, 0)
    index = index[np.isfinite(command[index]).all(axis=1)]
    time, angle = t[index], position[index]
    time = time - time.mean(axis=1, keepdims=True)
    deviation = angle - angle.mean(axis=1, keepdims=True)
    slope = np.sum(time * deviation, axis=1) / np.sum(time**2, axis=1)
    residual = deviation - slope[:, None] * time
    variance = np.sum(residual**2, axis=1) / (BLOCK - 2)
    drift = np.abs(slope) * np.ptp(time, axis=1)
    still = drift <= np.maximum(step, 3 * np.sqrt(variance))
    if not still.any():
        return angle[still], variance[still]
    still &= variance <= 2.5 * max(_quietest(variance[still], BLOCK - 2), step**2 / 12)
    return angle[still], variance[still]


def _quietest(variance: Array, freedom: float) -> float:
    """Variance of blocks (N,) of noise, some with motion, from the lowest fifth: chi-square."""
    if variance.size < 5:
        return float(variance.min())
    return float(np.quantile(variance, 0.2)) * freedom / float(chdtri(freedom, 0.8))


def _noise_before_rounding(blocks: Array) -> float:
    """Maximum-likelihood noise before rounding, in steps, of blocks (N, BLOCK) at unknown rest."""
    sd = np.geomspace(0.03, 1, 36)[:, None, None]
    angle = np.arange(-0.5, 0.5, 0.05)[:, None]
    rounded = np.round(blocks - np.median(blocks, axis=1, keepdims=True))
    level = np.unique(rounded)
    counts = (rounded[:, :, None] == level).sum(axis=1)
    inside = ndtr((level + 0.5 - angle) / sd) - ndtr((level - 0.5 - angle) / sd)
    each = logsumexp(np.log(np.maximum(inside, 1e-300)) @ counts.T, axis=1)
    likelihood = each.sum(axis=1)
    return float(sd[np.argmax(likelihood), 0, 0])
