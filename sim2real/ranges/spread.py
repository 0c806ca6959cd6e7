"""The uniform distribution that a number is drawn from, episode by episode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]

SMALLEST_SPREAD_S = 1e-4
"""Half-widths below it are all one: a tenth of a millisecond."""
LAW_SD_S = 2e-4
"""What no law of a servo gets better than."""


@dataclass(frozen=True)
class Spread:
    """A uniform distribution that latencies were drawn from, as far as they tell.

    Attributes:
        centre: In s.
        half_width: In s.
        half_width_90: 90 % interval of the half-width in s.
    """

    centre: float
    half_width: float
    half_width_90: tuple[float, float]


def spread(seconds: Array, sd: Array) -> Spread:
    """The uniform distribution behind latencies (E,) that are known to within ``sd`` (E,).

    Posterior medians of centre and half-width, on a grid, under a prior that is flat in the centre
    and in the logarithm of the half-width. The likelihood of each latency is the uniform density
    smeared by its own error, so that errors of the fit are not counted as spread.
    """
    reach = float(np.ptp(seconds)) + 3 * float(np.median(sd)) + 10 * SMALLEST_SPREAD_S
    half = np.geomspace(SMALLEST_SPREAD_S, 3 * reach, 160)
    middle = 0.5 * float(seconds.max() + seconds.min())
    centre = middle + np.linspace(-1.0, 1.0, 201) * reach
    log_density = np.zeros((half.size, centre.size))  # the prior is flat in the grid's steps
    for value, error in zip(seconds, np.maximum(sd, LAW_SD_S), strict=True):
        above = ndtr((centre[None] + half[:, None] - value) / error)
        below = ndtr((centre[None] - half[:, None] - value) / error)
        log_density += np.log(np.maximum(above - below, 1e-300)) - np.log(2 * half[:, None])
    weight = np.exp(log_density - log_density.max())
    low, median, high = _quantiles(half, weight.sum(axis=1), (0.05, 0.5, 0.95))
    (best,) = _quantiles(centre, weight.sum(axis=0), (0.5,))
    return Spread(best, median, (low, high))


def _quantiles(grid: Array, weight: Array, shares: Sequence[float]) -> list[float]:
    total = np.cumsum(weight)
    return [float(np.interp(share, (total - 0.5 * weight) / total[-1], grid)) for share in shares]
