"""Prior of the parameters of swims, and their errors linearised about a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array

_HOLDS = 4
"""Iterations in which columns are fixed at their bounds and the others are solved again."""


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
        covariance = np.zeros((n, n))
        covariance[: self.mean.size, : self.mean.size] = self.covariance
        covariance[self.mean.size :, self.mean.size :] = np.diag(sizes**2)
        zeros = np.zeros(sizes.size)
        return SwimPrior(
            np.concatenate([self.mean, zeros]), covariance,
            np.concatenate([self.imitation, sizes]), self.shares,
        )  # fmt: skip


@dataclass(frozen=True)
class Slope:
    """Linear model of a swim's errors near a point: ``rows + slope @ (x - at)``.

    Attributes:
        at: The point, shape (F,).
        slope: Derivatives of the weighted errors, shape (n, F).
        normal: ``slope.T @ slope``.
    """

    at: Array
    slope: Array
    normal: Array


@dataclass(frozen=True)
class Fit:
    """Fit of a hypothesis.

    Attributes:
        x: The point, shape (F,): 0 for effects that are not in the hypothesis.
        rows: Weighted errors there, shape (n,).
        loss: Negative logarithm of likelihood times prior.
        near: Linear model that the fit used.
        local: Whether the linear model was computed at this point.
    """

    x: Array
    rows: Array
    loss: float
    near: Slope
    local: bool = False


def together(
    parts: Sequence[tuple[Array, Array]], variance: Array
) -> tuple[Array, Array, list[Array]]:
    """Combine swims whose parameters vary about common ones (a linear mixed model).

    Args:
        parts: Curvature (F, F) and gradient (F,) of each swim's loss at one point.
        variance: Variance of a swim's parameters about the common ones, shape (F,).

    Returns:
        Curvature and gradient of the sum of losses with respect to the common parameters, and the
        covariance of each swim's deviations given the common parameters.
    """
    covariances = [np.asarray(np.linalg.inv(normal + np.diag(1 / variance))) for normal, _ in parts]
    pairs = list(zip(parts, covariances, strict=True))
    curvature = np.sum(
        [normal - normal @ covariance @ normal for (normal, _), covariance in pairs], axis=0
    )
    total_gradient = np.sum(
        [gradient - normal @ covariance @ gradient for (normal, gradient), covariance in pairs],
        axis=0,
    )
    return curvature, total_gradient, covariances


def bounded(curvature: Array, gradient: Array, room: Array) -> Array:
    """Minimiser of a quadratic within bounds ``room`` (2, F), with columns at a bound fixed."""
    step = -np.linalg.solve(curvature, gradient)
    fixed = np.zeros(step.size, dtype=bool)
    for _ in range(_HOLDS):
        outside = (step < room[0]) | (step > room[1])
        if not (outside & ~fixed).any():
            break
        fixed |= outside
        step = np.clip(step, room[0], room[1])
        free = ~fixed
        reduced = gradient[free] + curvature[np.ix_(free, fixed)] @ step[fixed]
        step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], reduced)
    return np.clip(step, room[0], room[1])
