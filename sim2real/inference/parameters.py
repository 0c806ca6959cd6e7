"""Parameters of servos, effects, bodies, fluids and cameras, their priors, points among them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.units import unit_of


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter with bounds and prior."""

    name: str  # fixed, ends with its unit
    low: float
    high: float
    typical: float  # a size that matters: the natural unit of a fit
    nominal: float = 0.0  # value without further knowledge; 0 where an effect is absent
    prior_sd: float = np.inf  # of a normal prior about ``nominal``; infinite: uniform in the bounds
    # whether the prior is that of the logarithm, to which, in a fit of a motor, also ``typical``,
    # ``nominal`` and ``prior_sd`` refer; ``low`` is then above 0
    log: bool = False
    shared: bool = True  # by all recordings; otherwise each has its own value
    unit: str = ""  # SI; by default from the ending of the name
    starts: tuple[float, ...] = ()  # of fits, in typical values; empty for the default ones

    def __post_init__(self) -> None:
        """Derive the unit from the name."""
        if not self.unit:
            object.__setattr__(self, "unit", unit_of(self.name))

    def __str__(self) -> str:
        """Description of its prior."""
        if np.isfinite(self.prior_sd) and self.log:
            middle, factor = np.exp([self.nominal, self.prior_sd])
            return f"log-normal {middle:.4g} {self.unit}, a factor of {factor:.3g}"
        if np.isfinite(self.prior_sd):
            return f"normal {self.nominal:.4g} ± {self.prior_sd:.4g} {self.unit}".rstrip()
        kind = "log-uniform" if self.log else "uniform"
        return f"{kind} {self.low:.4g} to {self.high:.4g} {self.unit}".rstrip()


def column(parameters: Sequence[Parameter], field: str) -> Array:
    """One field of each of F parameters, shape (F,)."""
    return np.array([getattr(p, field) for p in parameters], dtype=np.float64)


def kronecker(count: int, dimensions: int, rng: np.random.Generator) -> Array:
    """The first N points of a randomly shifted Kronecker sequence in the unit cube, shape (N, D).

    They fill it evenly, without the 0.2 s that importing ``scipy.stats`` takes. Source:
    Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods (SIAM, 1992), ch. 3. The
    slopes are powers of the inverse of the root of x^(D + 1) = x + 1, for D = 1 the golden ratio.
    """
    root = 1.5
    for _ in range(64):
        root = (1 + root) ** (1 / (dimensions + 1))
    slopes = root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((rng.random(dimensions) + np.arange(count)[:, None] * slopes) % 1.0)


def apart(points: Array, distance: float, most: int | None = None) -> list[int]:
    """Indices of the points (N, D) that each differ from all chosen before them in a value.

    By more than ``distance``; the first ``most``.
    """
    chosen: list[int] = []
    for k, point in enumerate(points):
        if len(chosen) == most:
            break
        if (np.abs(points[chosen] - point).max(axis=1) > distance).all():
            chosen.append(k)
    return chosen
