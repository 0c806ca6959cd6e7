"""Prior of the parameters of swims, and their errors linearised about a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_HOLDS = 4
"""Times that columns are held at their bounds and the rest is solved anew."""


@dataclass(frozen=True)
class SwimPrior:
    """Prior of the F parameters of servos, force law and effects.

    The error of the twin looks like effects that are not there. A part of it is common to all swims
    of a robot and is learned from reference swims; the rest differs from swim to swim.

    Attributes:
        mean: Mean of each parameter; for effects the apparent size in reference swims, shape (F,).
        covariance: Covariance for a swim in which nothing is missing, shape (F, F).
        imitation: Standard deviation between swims of one robot, shape (F,).
        shares: Relative error of the twin by signal and frequency band, shape (4, 3); of this robot
            where reference swims are given.
    """

    mean: Array
    covariance: Array
    imitation: Array
    shares: Array

    def extended(self, sizes: Array) -> SwimPrior:
        """The prior with m more parameters of mean 0 and standard deviations ``sizes`` (m,)."""
        n = self.mean.size + sizes.size
        spread = np.zeros((n, n))
        spread[: self.mean.size, : self.mean.size] = self.covariance
        spread[self.mean.size :, self.mean.size :] = np.diag(sizes**2)
        more = np.zeros(sizes.size)
        return SwimPrior(
            np.concatenate([self.mean, more]), spread,
            np.concatenate([self.imitation, sizes]), self.shares,
        )  # fmt: skip


@dataclass(frozen=True)
class Slope:
    """A swim's errors near a point: ``rows + slope @ (x - at)``.

    Attributes:
        at: Shape (F,).
        slope: Shape (n, F).
        normal: ``slope.T @ slope``.
    """

    at: Array
    slope: Array
    normal: Array


@dataclass(frozen=True)
class Fit:
    """A hypothesis, fitted.

    Attributes:
        x: The point, shape (F,): 0 where an effect is not in it.
        rows: Weighted errors there, shape (n,).
        loss: Minus the logarithm of likelihood and prior.
        near: The slope that it was found with.
        looked: Whether that is the slope at its own point.
    """

    x: Array
    rows: Array
    loss: float
    near: Slope
    looked: bool = False


def together(parts: Sequence[tuple[Array, Array]], own: Array) -> tuple[Array, Array, list[Array]]:
    """What swims tell together of what they have in common, each with columns of its own about it.

    Args:
        parts: Curvature (F, F) and gradient (F,) of each swim's loss at one point.
        own: Variance of a swim's columns about those in common, shape (F,).

    Returns:
        Curvature and gradient of all losses by what is in common, and the covariance of each swim's
        own columns where that is known.
    """
    inner = [np.asarray(np.linalg.inv(normal + np.diag(1 / own))) for normal, _ in parts]
    both = list(zip(parts, inner, strict=True))
    whole = np.sum([normal - normal @ i @ normal for (normal, _), i in both], axis=0)
    pull = np.sum([gradient - normal @ i @ gradient for (normal, gradient), i in both], axis=0)
    return whole, pull, inner


def bounded(curvature: Array, gradient: Array, room: Array) -> Array:
    """The step that is best by a quadratic, within ``room`` (2, F): what would leave it is held."""
    step = -np.linalg.solve(curvature, gradient)
    held = np.zeros(step.size, dtype=bool)
    for _ in range(_HOLDS):
        beyond = (step < room[0]) | (step > room[1])
        if not (beyond & ~held).any():
            break
        held |= beyond
        step = np.clip(step, room[0], room[1])
        free = ~held
        pull = gradient[free] + curvature[np.ix_(free, held)] @ step[held]
        step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], pull)
    return np.clip(step, room[0], room[1])
