"""Variance between groups and within them, from estimates whose errors are known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from sim2real.arrays import Array
from sim2real.inference.normal import LEVEL

Quantiles = tuple[float, float, float]
"""Lower end of an interval, median and upper end."""


@dataclass(frozen=True)
class VarianceComponents:
    """Posterior of ``value = mean + group + member + error``, all but the mean normal."""

    mean: Quantiles  # of all groups
    # standard deviation between groups, including that within them where no group has two members;
    # None for one group
    between: Quantiles | None
    within: Quantiles | None  # the same within groups; None where no group has two members
    new: Quantiles  # a further member of a further group, or of the only group


def variance_components(
    values: Array,
    sd: Array,
    groups: Sequence[object],
    *,
    level: float = LEVEL,
    points: int = 48,
    own: Sequence[tuple[float, float]] = ((0.2, 0.1), (0.5, 0.1), (1.0, 0.8)),
) -> VarianceComponents:
    """Posterior of the mean and of both standard deviations, on a grid of ``points`` for each.

    Errors are independent, or in part those of all estimates, as of a law that leaves something
    out: ``own`` has the probability of each share of the standard deviation that is each estimate's
    own. The rest shows in no difference, and widens the intervals of the mean and of a new member.
    The mean has a flat prior and is integrated out; the standard deviations have the reference
    prior of Bodnar and others (Statistics in Medicine 36, 2017, eq. 9), for each level given that
    below it. Without errors this is the prior of Box and Tiao (Bayesian Inference in Statistical
    Analysis, 1973, section 5.2), and a new member of n groups has Student's distribution with n - 1
    degrees of freedom.

    Args:
        values: The estimates, at least two, shape (N,).
        sd: Standard deviations of their errors, shape (N,).
        groups: Label of the group of each of them, N of them.
        level: Probability of the intervals.
        points: See above.
        own: See above.
    """
    labels = list(dict.fromkeys(groups))
    alone, single = len(labels) == 1, len(set(groups)) == values.size
    if alone:
        labels = list(range(values.size))
    number = np.arange(values.size) if alone else np.array([labels.index(g) for g in groups])
    scale = max(float(np.ptp(values)), float(np.median(sd)), 1e-9 * float(np.abs(values).max()))
    grid = np.geomspace(1e-3, 1e3, points) * max(scale, 1e-12)
    inner = np.zeros(1) if alone or single else grid
    axes = np.meshgrid(grid**2, inner**2, [share for share, _ in own], indexing="ij")
    tau, omega, part = (axis.ravel() for axis in axes)
    error = np.maximum(np.outer(part, sd), 1e-2 * grid[0])
    shared = (1 - part**2) * float(np.median(sd)) ** 2
    members = np.eye(len(labels))[number]  # (N, G)
    variance = omega[:, None] + error**2  # (K, N), as all below: a row for each point
    weight = (1 / variance) @ members
    middle = (values / variance) @ members / weight
    inside = (np.log(variance) + (values - middle[:, number]) ** 2 / variance).sum(axis=1)
    spread = tau[:, None] + 1 / weight
    precision = (1 / spread).sum(axis=1)
    mean = (middle / spread).sum(axis=1) / precision
    outside = (np.log(spread * weight) + (middle - mean[:, None]) ** 2 / spread).sum(axis=1)
    # the reference prior, times the standard deviation for a grid of its logarithm
    log_density = np.log(tau) + 0.5 * np.log((spread**-2).sum(axis=1))
    if not (alone or single):
        freedom = 1 - 1 / members.sum(axis=0)[number]
        log_density += np.log(omega) + 0.5 * np.log((freedom / variance**2).sum(axis=1))
    log_density -= 0.5 * (inside + outside + np.log(precision))
    log_density += np.tile(np.log([odds for _, odds in own]), tau.size // len(own))
    density = np.exp(log_density - log_density.max())
    table = density.reshape(points, inner.size, -1).sum(axis=2)
    first = grid_quantiles(grid, table.sum(axis=1), level)
    return VarianceComponents(
        _mixture_quantiles(density, mean, 1 / precision + shared, level),
        None if alone else first,
        first if alone else None if single else grid_quantiles(grid, table.sum(axis=0), level),
        _mixture_quantiles(density, mean, 1 / precision + shared + tau + omega, level),
    )


def grid_quantiles(grid: Array, weight: Array, level: float = LEVEL) -> Quantiles:
    """Central interval and median of a distribution by its weights (K,) on a grid (K,)."""
    total = np.cumsum(weight)
    low, middle, high = np.interp(_shares(level), (total - 0.5 * weight) / total[-1], grid)
    return float(low), float(middle), float(high)


def _shares(level: float) -> Array:
    return np.array([0.5 - level / 2, 0.5, 0.5 + level / 2])


def _mixture_quantiles(weight: Array, mean: Array, variance: Array, level: float) -> Quantiles:
    """Central interval and median of a mixture of K normal distributions."""
    sd = np.sqrt(variance)

    def above(x: float, share: float) -> float:
        return float(ndtr((x - mean) / sd) @ weight / weight.sum()) - share

    ends = (mean - 40 * sd).min(), (mean + 40 * sd).max()
    low, middle, high = (brentq(above, *ends, args=(x,), xtol=1e-15) for x in _shares(level))
    return float(low), float(middle), float(high)
