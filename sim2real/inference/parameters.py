"""Parameters of servos, effects, bodies, fluids and cameras, and their priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.units import unit_of

_INSIDE = 1e-4


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter with bounds and prior.

    Attributes:
        name: Its fixed name, which ends with its unit.
        low: Smallest admissible value.
        high: Largest admissible value.
        typical: A size that matters: the natural unit of a fit.
        nominal: Value without further knowledge; 0 where an effect is absent.
        prior_sd: Standard deviation of its normal prior about ``nominal``; infinite for a uniform
            prior between the bounds.
        log: Whether the prior is that of the logarithm; ``low`` is then above 0. A fit of a motor
            searches the logarithm, to which its ``typical``, ``nominal`` and ``prior_sd`` refer.
        shared: Whether all recordings share one value; otherwise each has its own.
        unit: Its SI unit; by default from the ending of the name.
        starts: Starting values of fits, in typical values; empty for the default ones.
    """

    name: str
    low: float
    high: float
    typical: float
    nominal: float = 0.0
    prior_sd: float = np.inf
    log: bool = False
    shared: bool = True
    unit: str = ""
    starts: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Derive the unit from the name."""
        if not self.unit:
            object.__setattr__(self, "unit", unit_of(self.name))

    def __str__(self) -> str:
        """Description of its prior."""
        if np.isfinite(self.prior_sd):
            return f"normal {self.nominal:.4g} ± {self.prior_sd:.4g} {self.unit}".rstrip()
        kind = "log-uniform" if self.log else "uniform"
        return f"{kind} {self.low:.4g} to {self.high:.4g} {self.unit}".rstrip()


def column(parameters: Sequence[Parameter], field: str) -> Array:
    """One field of each of F parameters, shape (F,)."""
    return np.array([getattr(p, field) for p in parameters], dtype=np.float64)


@dataclass(frozen=True)
class Priors:
    """Independent priors of F bounded parameters, in unbounded coordinates.

    The coordinate is z = log(s / (1 - s)), where s, between 0 and 1, is the position of the value,
    or of its logarithm, between ``low`` and ``high``.
    """

    each: Sequence[Parameter]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.each)

    @property
    def _ends(self) -> tuple[Array, Array, Mask]:
        log = np.array([p.log for p in self.each])
        ends = np.array([[p.low, p.high] for p in self.each])
        scaled = np.where(log[:, None], np.log(np.where(log[:, None], ends, 1.0)), ends)
        return scaled[:, 0], scaled[:, 1], log

    def values(self, z: Array) -> Array:
        """Values of the parameters at coordinates ``z`` (..., F)."""
        low, high, log = self._ends
        scaled = low + (high - low) * _share(z)
        return np.where(log, np.exp(np.where(log, scaled, 0.0)), scaled)

    def coordinates(self, values: Array) -> Array:
        """Coordinates of ``values`` (..., F); values at or beyond a bound are moved inside."""
        low, high, log = self._ends
        scaled = np.where(log, np.log(np.maximum(np.where(log, values, 1.0), 1e-300)), values)
        share = np.clip((scaled - low) / (high - low), _INSIDE, 1 - _INSIDE)
        return np.asarray(np.log(share) - np.log1p(-share))

    def slope(self, z: Array) -> Array:
        """Derivative of each value by its coordinate at ``z`` (..., F)."""
        low, high, log = self._ends
        share = _share(z)
        steep = (high - low) * share * (1 - share)
        return np.where(log, steep * self.values(z), steep)

    def curvature(self, z: Array) -> Array:
        """Minus the second derivative of ``log_density`` by each coordinate ``z`` (..., F)."""
        share = _share(z)
        return np.asarray(2 * share * (1 - share))

    def log_density(self, z: Array) -> Array:
        """Log-density of the coordinates ``z`` (..., F), shape (...): logistic for each."""
        return np.asarray(-(np.logaddexp(0.0, z) + np.logaddexp(0.0, -z)).sum(axis=-1))

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Values drawn from the priors, shape (count, F)."""
        share = rng.random((count, len(self.each)))
        return self.values(np.log(share) - np.log1p(-share))


def _share(z: Array) -> Array:
    return np.asarray(0.5 * (1 + np.tanh(0.5 * z)))


@dataclass(frozen=True)
class Gaussian:
    """A normal distribution of F parameters, as a prior or as the result of a fit.

    Attributes:
        mean: Shape (F,).
        covariance: Shape (F, F).
    """

    mean: Array
    covariance: Array

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Gaussian:
        """The independent priors that the parameters state."""
        return cls(column(parameters, "nominal"), np.diag(column(parameters, "prior_sd") ** 2))

    @property
    def root(self) -> Array:
        """A matrix W (F, F) with W.T @ W the inverse of the covariance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)))
