"""What is believed before a swim, and swims as they are near a point: linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_HOLDS = 4
"""Times that columns are held at their bounds and the rest is solved anew."""


@dataclass(frozen=True)
class Belief:
    """What is known before a swim, of servos and law and of all effects, F columns.

    The twin's error passes for effects that are not there: for some in all swims of a robot alike,
    which its references tell, for some in each swim anew.

    Attributes:
        mean: Of servos and law; of effects what a robot's swims seem to have of them all, (F,).
        covariance: Of a swim in which nothing is missing, shape (F, F).
        imitation: Standard deviation from one swim of a robot to another, shape (F,).
        shares: The twin's error by signal and band, (4, 3): that of this robot, where swims tell.
    """

    mean: Array
    covariance: Array
    imitation: Array
    shares: Array

    def beside(self, sizes: Array) -> Belief:
        """With more columns, which have these standard deviations (m,) about 0."""
        n = self.mean.size + sizes.size
        spread = np.zeros((n, n))
        spread[: self.mean.size, : self.mean.size] = self.covariance
        spread[self.mean.size :, self.mean.size :] = np.diag(sizes**2)
        more = np.zeros(sizes.size)
        return Belief(
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
