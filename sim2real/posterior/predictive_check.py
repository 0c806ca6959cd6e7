"""Predictive check of a posterior on a held-out recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel
from sim2real.posterior.likelihood import loaded
from sim2real.posterior.servo import ServoPosterior
from sim2real.servo.rollout import rollout_on
from sim2real.servo.trace import Trace

LEVELS = (0.5, 0.8, 0.95)
TOO_NARROW = 0.85
"""Share of samples within the 95 % band below which the posterior is too narrow."""
DRAWS = 200


@dataclass(frozen=True)
class PredictiveCheck:
    """Predictions of a posterior for one recording, and the measured angles.

    Attributes:
        recording: Its name.
        t: Times in s, shape (T,).
        measured: Angles in rad, shape (T,), NaN where the sample was not held out.
        median: Median of the predictions, shape (T,).
        band: Ends of the central 95 % of the predictions, with noise, shape (2, T).
        covered: Share of measured angles within the central band of each of ``LEVELS``.
        rmse: Root mean square error of the median in rad.
    """

    recording: str
    t: Array
    measured: Array
    median: Array
    band: Array
    covered: Mapping[float, float]
    rmse: float

    @property
    def holds(self) -> bool:
        """Whether the bands are wide enough."""
        return self.covered[LEVELS[-1]] >= TOO_NARROW


def predictive_check(
    posterior: ServoPosterior, joint: JointModel, held_out: Trace, rng: np.random.Generator
) -> PredictiveCheck:
    """Predict a recording with draws of the posterior and compare it with the measured angles.

    Noise is added to every prediction, with the root mean square of the residual of the fit.
    Source: Gelman, Meng and Stern, Statistica Sinica 6 (1996) 733-807.

    Args:
        posterior: The posterior.
        joint: Its model.
        held_out: A trace whose ``used`` samples were not fitted.
        rng: Generator for draws and noise.
    """
    trace = loaded(held_out, joint)
    values = posterior.values[rng.choice(posterior.values.shape[0], DRAWS, replace=True)]
    optimum = posterior.data.theta(posterior.optimum[None])
    residuals = [
        (rollout_on(fitted, optimum)[0] - fitted.position)[fitted.used]
        for fitted in posterior.data.traces
    ]
    angles = rollout_on(trace, posterior.data.theta(values))
    noisy = angles + rng.normal(0.0, rms(residuals), angles.shape)
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
