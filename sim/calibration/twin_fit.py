"""Fit the body, and the servos with it, to swims in a pool.

Least squares on surge, sway, yaw rate and joint angles, each weighted by what is left of it after a
first fit. Its residuals are correlated in time and hold what the simulator lacks, so the intervals
come from the scores' own scatter over two seconds (the sandwich of White, Econometrica 48 (1980)
817, with a long-run covariance), not from a likelihood that would count each sample as news.
Derivatives are central differences, all simulations of a step in one launch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from sim.calibration.swim_problem import BLOCK, HELD_OUT_SHARE, Minimum, SwimProblem
from sim.inference.swims import Simulator, Swim
from sim2real.inference.correlated_noise import long_run
from sim2real.inference.parameters import Gaussian, Parameter, column
from sim2real.model import Model

Array = NDArray[np.float64]

_FINEST = 1e-6
"""Error of a signal, in its own unit, below which it has no more weight: it may be exact."""
_ROUNDS = 2
_LEVEL = 0.9
_STEP = 0.05
"""Step of the derivatives, in the parameters' sizes."""
_INSIDE = 1e-9


@dataclass(frozen=True)
class Calibrated:
    """What a calibration found.

    Attributes:
        model: The calibrated model.
        free: What was fitted.
        best: Its values, shape (F,).
        sd: Their standard deviations, shape (F,).
        rmse: Root mean square error of each signal on what was held out, before and after, shape
            (2, 3 + J), or (2, K) of another view.
        train: Likewise on what was fitted.
    """

    model: Model
    free: tuple[Parameter, ...]
    best: Array
    sd: Array
    rmse: Array
    train: Array

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
    progress: Callable[[float], None] = lambda share: None,
) -> Calibrated:
    """Fit parameters to the first part of each swim and score them on the rest.

    Args:
        swims: Recordings.
        model: Where to start.
        free: What to fit.
        simulator: The twin or the fluid.
        held_out: Share of each swim at its end that is held out.
        evaluations: Most steps of each round.
        view: What of the signals (..., T, 3 + J) is compared, shape (..., T, K).
        progress: Called with the share that is done.
    """
    free = tuple(free)
    problem = SwimProblem(swims, model, free, simulator, Gaussian.of(free), view, held_out)
    unit, nominal = column(free, "typical"), column(free, "nominal")
    before = problem.errors(nominal[None])
    weight = 1 / np.maximum(problem.rmse(before, held=False)[0], _FINEST)
    best, after = nominal, before
    for done in range(_ROUNDS):
        found = problem.minimise(
            best, [weight] * len(swims), unit=unit, step=_STEP, evaluations=evaluations
        )
        best = found.values
        after = problem.errors(best[None])
        progress((done + 1) / _ROUNDS)
        if done < _ROUNDS - 1:
            weight = 1 / np.maximum(problem.rmse(after, held=False)[0], _FINEST)
    both = (before, after)
    return Calibrated(
        model=problem.with_values(best),
        free=free,
        best=best,
        sd=_sandwich(found, problem, weight.size),
        rmse=np.concatenate([problem.rmse(e, held=True) for e in both]),
        train=np.concatenate([problem.rmse(e, held=False) for e in both]),
    )


def _sandwich(found: Minimum, problem: SwimProblem, signals: int) -> Array:
    """Standard deviations from the scatter of the scores over two seconds, shape (F,)."""
    bread = np.linalg.inv(found.curvature)
    score = (found.slope * found.error[:, None]).reshape(-1, signals, len(found.values))
    ends = np.cumsum(problem.cut)[:-1]
    parts = np.split(score.sum(axis=1), ends)
    meat = np.linalg.inv(problem.prior.covariance)
    meat = meat + np.sum([long_run(one, min(BLOCK, len(one))) for one in parts], axis=0)
    return np.asarray(np.sqrt(np.diag(bread @ meat @ bread)))


__all__ = ["Calibrated", "calibrate"]
