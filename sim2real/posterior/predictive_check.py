"""Predictive check of a posterior on a held-out recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array
from sim2real.identification.search import fit
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel
from sim2real.posterior.servo import ServoPosterior, loaded, normal_draws
from sim2real.servo.rollout import rollout_on
from sim2real.servo.trace import Trace

LEVELS = (0.5, 0.8, 0.95)
TOO_NARROW = 0.85
"""Share of samples within the 95 % band below which the posterior is too narrow."""
DRAWS = 200


@dataclass(frozen=True)
class PredictiveCheck:
    """Predictions of a posterior for one recording, and the measured angles."""

    recording: str  # its name
    t: Array  # times in s, shape (T,)
    measured: Array  # angles in rad, shape (T,), NaN where the sample was not held out
    median: Array  # median of the predictions, shape (T,)
    band: Array  # ends of the central 95 % of the predictions, with noise, shape (2, T)
    # share of measured angles within the central band of each of ``LEVELS``
    covered: Mapping[float, float]
    rmse: float  # root mean square error of the median in rad

    @property
    def holds(self) -> bool:
        """Whether the bands are wide enough."""
        return self.covered[LEVELS[-1]] >= TOO_NARROW


def predictive_check(
    posterior: ServoPosterior,
    joint: JointModel,
    fitted: Sequence[Trace],
    held_out: Trace,
    rng: np.random.Generator,
) -> PredictiveCheck:
    """Predict a recording with a fit to others and compare it with the measured angles.

    The parameters are drawn from the normal distribution of a fit without the recording; noise is
    added to every prediction, with the root mean square of the residual of that fit. Source:
    Gelman, Meng and Stern, Statistica Sinica 6 (1996) 733-807.
    ``posterior`` is that of all recordings; of ``held_out`` the ``used`` samples are not fitted.
    """
    trace = loaded(held_out, joint)
    without = replace(posterior.problem, traces=[loaded(one, joint) for one in fitted])
    start = without.row.copy()
    start[without.columns] = posterior.optimum
    best = fit(without, start[None], rounds=2)
    rows = np.tile(best.row, (DRAWS, 1))
    rows[:, without.columns] = normal_draws(best, rng, DRAWS)
    angles = rollout_on(trace, rows)
    noisy = angles + rng.normal(0.0, rms([best.error]) * trace.fit_ratio, angles.shape)
    measured = trace.measured
    present = np.isfinite(measured)
    covered = {}
    for level in LEVELS:
        low, high = np.quantile(noisy, [0.5 - level / 2, 0.5 + level / 2], axis=0)
        covered[level] = float(((measured >= low) & (measured <= high))[present].mean())
    median = np.median(angles, axis=0)
    return PredictiveCheck(
        recording=held_out.name,
        t=trace.t,
        measured=measured,
        median=median,
        band=np.quantile(noisy, [0.025, 0.975], axis=0),
        covered=covered,
        rmse=rms([(median - measured)[present]]),
    )
