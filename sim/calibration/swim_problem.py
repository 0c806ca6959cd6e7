"""Swims as a problem of the shared inference: what parameters make of every signal, weighted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim2real.inference import least_squares
from sim2real.inference.least_squares import Expansion, central, expansion
from sim2real.inference.parameters import Gaussian, Parameter, column
from sim2real.model import Model

Array = NDArray[np.float64]

HELD_OUT_SHARE = 1 / 3
"""Share of a swim, at its end, that the fit does not see."""
BLOCK = 100
"""Samples of a block: two seconds, a beat or more."""
_LOST = 1e3
"""Error of a signal of a robot that was stopped."""


@dataclass(frozen=True)
class Minimum:
    """Where a fit of swims ended.

    Attributes:
        values: Of the parameters, shape (F,).
        loss: Half the sum of squares, the prior's included.
        curvature: Its second derivatives, shape (F, F).
        error: Weighted errors of what was fitted, swim by swim, sample by sample, shape (n,).
        slope: Their derivatives, shape (n, F).
    """

    values: Array
    loss: float
    curvature: Array
    error: Array
    slope: Array


@dataclass(frozen=True)
class SwimProblem:
    """Parameters that are to explain the first part of some swims.

    Attributes:
        swims: The recordings.
        model: What has the parameters.
        free: What is fitted, F of them.
        simulator: The twin, the fluid or its emulator.
        prior: Of the parameters.
        view: What of the signals (..., T, 3 + J) is compared, shape (..., T, K).
        held_out: Share of each swim at its end that is not fitted.
    """

    swims: Sequence[Swim]
    model: Model
    free: Sequence[Parameter]
    simulator: Simulator
    prior: Gaussian
    view: Callable[[Array], Array] = lambda signals: signals
    held_out: float = HELD_OUT_SHARE

    @property
    def cut(self) -> list[int]:
        """Samples of each swim that are fitted."""
        return [round(swim.t.size * (1 - self.held_out)) for swim in self.swims]

    def with_values(self, values: Array) -> Model:
        """The model with values (F,) of the parameters."""
        named = {p.name: float(x) for p, x in zip(self.free, values, strict=True)}
        return with_values(self.model, named)

    def errors(self, points: Array) -> list[Array]:
        """Simulated minus recorded signals for values (E, F), for each swim (E, T, K)."""
        models = [self.with_values(values) for values in points]
        return [
            np.nan_to_num(
                self.view(simulated(swim, models, self.simulator) - swim.signals), nan=_LOST
            )
            for swim in self.swims
        ]

    def fitted_rows(self, points: Array, weights: Sequence[Array]) -> Array:
        """Weighted errors of the fitted part for values (E, F), swim by swim: (E, n)."""
        parts = [
            (error * w)[:, :end].reshape(len(points), -1)
            for error, w, end in zip(self.errors(points), weights, self.cut, strict=True)
        ]
        return np.concatenate(parts, axis=1)

    def minimise(
        self, start: Array, weights: Sequence[Array], *, unit: Array, step: float, evaluations: int
    ) -> Minimum:
        """Least squares by the shared fitter; all simulations of a step go in one launch.

        Args:
            start: Values to start from, shape (F,).
            weights: One over the standard deviation of each error, (T, K) or (K,) a swim.
            unit: Natural sizes of the parameters, shape (F,).
            step: Step of the central differences, in them.
            evaluations: Most evaluations.
        """
        low, high = (column(self.free, end) / unit for end in ("low", "high"))
        root = self.prior.root

        def rows(x: Array) -> Array:
            values = x * unit
            beyond = (values - self.prior.mean) @ root.T
            return np.concatenate([self.fitted_rows(values, weights), beyond], axis=1)

        def expand(x: Array, _: NDArray[np.intp]) -> Expansion:
            error, slope = central(rows, x[0], np.full(x.shape[1], step), low, high)
            found = expansion(error, slope)
            found.aside.update(error=error[None], slope=slope[None])
            return found

        found = least_squares.minimise(
            expand, (start / unit)[None], low[None], high[None], evaluations=evaluations
        )
        at, F = found.expansion, len(self.free)
        return Minimum(
            values=found.x[0] * unit,
            loss=float(at.loss[0]),
            curvature=at.curvature[0] / np.outer(unit, unit),
            error=at.aside["error"][0, :-F],
            slope=at.aside["slope"][0, :-F] / unit,
        )

    def rmse(self, errors: Sequence[Array], *, held: bool) -> Array:
        """Root mean square of ``errors`` of each signal over all swims, shape (E, K)."""
        parts = [e[:, c:] if held else e[:, :c] for e, c in zip(errors, self.cut, strict=True)]
        return np.asarray(np.sqrt(np.mean(np.concatenate(parts, axis=1) ** 2, axis=1)))


def seen(signals: Array) -> Array:
    """Signals (..., T, 3 + J) with the means of the first three over two seconds beside them."""
    slow = uniform_filter1d(signals[..., :3], BLOCK, axis=-2, mode="nearest")
    return np.concatenate([signals, slow], axis=-1)
