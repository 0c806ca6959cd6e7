"""Fit the body, and the servos with it, to swims in a pool.

Least squares on surge, sway, yaw rate and joint angles, each weighted by its residual after a first
fit. The residuals are correlated in time and contain errors of the simulator: a signal counts as
one sample per autocorrelation time of its residual, so that the priors keep their weight, and the
intervals use the covariance of the scores over two seconds (the sandwich of White, Econometrica 48
(1980) 817, with a long-run covariance), not a likelihood of independent samples.
Derivatives are central differences, all simulations of a step in one launch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from sim.calibration.swim_problem import BLOCK, HELD_OUT_SHARE, Minimum, SwimProblem
from sim.inference.swims import Simulator, Swim
from sim2real.arrays import Array
from sim2real.inference.correlated_noise import long_run
from sim2real.inference.parameters import Gaussian, Parameter, column
from sim2real.model import Model
from sim2real.progress import Progress

_FINEST = 1e-6
"""Least error of a signal in its unit, which limits its weight: the fit may be exact."""
_ROUNDS = 2
_LEVEL = 0.9
_STEP = 0.05
"""Step of the derivatives, in the parameters' sizes."""


@dataclass(frozen=True)
class Calibrated:
    """Result of a calibration.

    Attributes:
        model: The calibrated model.
        free: The F fitted parameters.
        best: Their values, shape (F,).
        covariance: Their covariance, shape (F, F).
        rmse: Held-out root mean square error of each signal, before and after, shape (2, 3 + J), or
            (2, K) of another view.
        train: Likewise on the fitted part.
    """

    model: Model
    free: tuple[Parameter, ...]
    best: Array
    covariance: Array
    rmse: Array
    train: Array

    @property
    def sd(self) -> Array:
        """Standard deviations of the parameters, shape (F,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def interval(self, level: float = _LEVEL) -> Array:
        """Central intervals, shape (F, 2)."""
        reach = float(norm.ppf(0.5 + level / 2)) * self.sd
        return np.stack([self.best - reach, self.best + reach], axis=1)


def calibrate(
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Parameter],
    simulator: Simulator,
    *,
    held_out: float = HELD_OUT_SHARE,
    evaluations: int = 20,
    view: Callable[[Array], Array] = lambda signals: signals,
    progress: Progress = lambda share: None,
) -> Calibrated:
    """Fit parameters to the first part of each swim and score them on the rest.

    Args:
        swims: Recordings.
        model: Model to start from.
        free: Parameters to fit.
        simulator: The twin or the fluid.
        held_out: Share of each swim, at its end, that is held out.
        evaluations: Largest number of steps of each round.
        view: Function of signals (..., T, 3 + J) to those that are compared, shape (..., T, K).
        progress: Called with the share that is done.
    """
    free = tuple(free)
    problem = SwimProblem(swims, model, free, simulator, Gaussian.of(free), view, held_out)
    unit, nominal = column(free, "typical"), column(free, "nominal")
    before = problem.errors(nominal[None])
    weight = 1 / np.maximum(problem.rmse(before, held=False)[0], _FINEST)
    best, after = nominal, before
    for done in range(_ROUNDS):
        minimum = problem.minimise(
            best, [weight] * len(swims), unit=unit, step=_STEP, evaluations=evaluations
        )
        best = minimum.values
        after = problem.errors(best[None])
        progress((done + 1) / _ROUNDS)
        if done < _ROUNDS - 1:
            times = problem.autocorrelation_times(after)
            weight = 1 / np.maximum(problem.rmse(after, held=False)[0], _FINEST) / np.sqrt(times)
    pair = (before, after)
    return Calibrated(
        model=problem.with_values(best),
        free=free,
        best=best,
        covariance=_sandwich(minimum, problem, weight.size),
        rmse=np.concatenate([problem.rmse(e, held=True) for e in pair]),
        train=np.concatenate([problem.rmse(e, held=False) for e in pair]),
    )


def _sandwich(minimum: Minimum, problem: SwimProblem, signals: int) -> Array:
    """Covariance from the scatter of the scores over two seconds, shape (F, F)."""
    bread = np.linalg.inv(minimum.curvature)
    score = (minimum.slope * minimum.error[:, None]).reshape(-1, signals, len(minimum.values))
    ends = np.cumsum(problem.cut)[:-1]
    parts = np.split(score.sum(axis=1), ends)
    meat = np.linalg.inv(problem.prior.covariance)
    meat = meat + np.sum([long_run(scores, min(BLOCK, len(scores))) for scores in parts], axis=0)
    return np.asarray(bread @ meat @ bread)
