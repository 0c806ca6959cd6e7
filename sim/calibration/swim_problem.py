"""Swims as a least-squares problem: weighted errors of all signals as a function of parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim2real.arrays import Array, Index
from sim2real.inference import least_squares
from sim2real.inference.correlated_noise import correlation_samples
from sim2real.inference.least_squares import Expansion, central, expansion
from sim2real.inference.parameters import Gaussian, Parameter, column
from sim2real.model import Model

HELD_OUT_SHARE = 1 / 3
"""Share of a swim, at its end, that the fit does not use."""
BLOCK = 100
"""Samples of a block: two seconds, at least one tail beat."""
_LOST = 1e3
"""Error of the signals of a robot that was stopped."""


@dataclass(frozen=True)
class Minimum:
    """Result of a minimisation.

    Attributes:
        values: Values of the parameters, shape (F,).
        loss: Half the sum of squares, with that of the prior.
        curvature: Its second derivatives, shape (F, F).
        error: Weighted errors of the fitted part, swim by swim, sample by sample, shape (n,).
        slope: Their derivatives, shape (n, F).
    """

    values: Array
    loss: float
    curvature: Array
    error: Array
    slope: Array


@dataclass(frozen=True)
class SwimProblem:
    """Fit of parameters to the first part of swims.

    Attributes:
        swims: The recordings.
        model: The model with the parameters.
        free: The F fitted parameters.
        simulator: The twin, the fluid or its emulator.
        prior: Prior of the parameters.
        view: Function of signals (..., T, 3 + J) to those that are compared, shape (..., T, K).
        held_out: Share of each swim, at its end, that is not fitted.
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
        """Number of fitted samples of each swim."""
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
            step: Step of the central differences, in these sizes.
            evaluations: Largest number of evaluations.
        """
        low, high = (column(self.free, end) / unit for end in ("low", "high"))
        root = self.prior.root

        def rows(x: Array) -> Array:
            values = x * unit
            prior_errors = (values - self.prior.mean) @ root.T
            return np.concatenate([self.fitted_rows(values, weights), prior_errors], axis=1)

        def expand(x: Array, _: Index) -> Expansion:
            error, slope = central(rows, x[0], np.full(x.shape[1], step), low, high)
            result = expansion(error, slope)
            result.aside.update(error=error[None], slope=slope[None])
            return result

        result = least_squares.minimise(
            expand, (start / unit)[None], low[None], high[None], evaluations=evaluations
        )
        final, F = result.expansion, len(self.free)
        return Minimum(
            values=result.x[0] * unit,
            loss=float(final.loss[0]),
            curvature=final.curvature[0] / np.outer(unit, unit),
            error=final.aside["error"][0, :-F],
            slope=final.aside["slope"][0, :-F] / unit,
        )

    def rmse(self, errors: Sequence[Array], *, held: bool) -> Array:
        """Root mean square of ``errors`` of each signal over all swims, shape (E, K)."""
        parts = [e[:, c:] if held else e[:, :c] for e, c in zip(errors, self.cut, strict=True)]
        return np.asarray(np.sqrt(np.mean(np.concatenate(parts, axis=1) ** 2, axis=1)))

    def autocorrelation_times(self, errors: Sequence[Array]) -> Array:
        """Mean integrated autocorrelation time of ``errors`` (1, T, K) over all swims, (K,)."""
        parts = [e[0, :c] for e, c in zip(errors, self.cut, strict=True)]
        times = [[correlation_samples(column) for column in e.T] for e in parts]
        return np.asarray(np.mean(times, axis=0))


def seen(signals: Array) -> Array:
    """Signals (..., T, 3 + J) and moving means of the first three over two seconds."""
    slow = uniform_filter1d(signals[..., :3], BLOCK, axis=-2, mode="nearest")
    return np.concatenate([signals, slow], axis=-1)
