"""Intervals of a fit whose residuals are correlated in time."""

import numpy as np
from scipy.signal import lfilter


def test_intervals_hold_where_residuals_are_correlated():
    """A line through correlated noise: intervals for independent noise would miss half the time."""
    from scipy.stats import binomtest

    from sim2real.identification.fit import Fit
    from sim2real.identification.uncertainty import uncertainty
    from sim2real.inference.least_squares import robust_scale
    from sim2real.inference.parameters import Parameter
    from sim2real.servo.parameters import COLUMNS

    held = 0
    x = np.linspace(-1, 1, 1500)
    slopes = np.stack([np.ones_like(x), x], axis=1)
    for seed in range(200):
        white = np.random.default_rng(seed).standard_normal(x.size)
        noise = lfilter([1.0], [1.0, -0.9], white)
        estimate = np.linalg.lstsq(slopes, noise, rcond=None)[0]
        error = slopes @ estimate - noise
        row = np.zeros(len(COLUMNS))
        row[:2] = estimate
        names = [Parameter(name, -9.0, 9.0, 1.0) for name in COLUMNS[:2]]
        fit = Fit(tuple(names), row, robust_scale(error), (error,), (slopes,), True, 1.0)
        spread = uncertainty(fit, np.full(2, 100.0))
        held += abs(estimate[1]) < spread.half_width[1]
    low, high = binomtest(held, 200).proportion_ci(0.99)
    assert high > 0.85, held
    assert low < 0.97, held
