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


def test_intervals_hold_where_errors_repeat_with_the_angle():
    """A servo that passes the same angles again and again, with an error that depends on them."""
    from sim2real.identification.fit import Fit, plain_row
    from sim2real.identification.uncertainty import uncertainty
    from sim2real.inference.least_squares import robust_scale
    from sim2real.inference.parameters import Parameter
    from sim2real.recording import Load
    from sim2real.servo.parameters import COLUMNS
    from sim2real.servo.trace import Trace

    t = np.arange(1000) / 50
    angle = 0.5 * np.sin(2 * np.pi * 0.5 * t)
    slopes = np.stack([angle, np.gradient(angle, t)], axis=1)
    free = tuple(Parameter(name, -9.0, 9.0, 1.0) for name in COLUMNS[:2])
    held, held_without, cases = 0, 0, 60
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        cycles, phase = rng.uniform(0.5, 10.0, 3), rng.uniform(0, 2 * np.pi, 3)
        repeating = np.sin(2 * np.pi * np.outer(angle, cycles) + phase).sum(axis=1)
        measured = 3e-3 * repeating + 1e-3 * rng.standard_normal(t.size)
        estimate = np.linalg.lstsq(slopes, measured, rcond=None)[0]
        error = slopes @ estimate - measured
        trace = Trace("a", "a", t, angle, angle - error, Load(0.002), np.ones(t.size, bool))
        row = plain_row(4.0, 0.1, 0.0)
        scale = robust_scale(error)
        fit = Fit(free, row, scale, (error,), (slopes,), True, 0.002)
        units = np.full(2, 100.0)
        held += abs(estimate[0]) < uncertainty(fit, units, [trace]).half_width[0]
        held_without += abs(estimate[0]) < uncertainty(fit, units).half_width[0]
    assert held_without < 0.5 * cases, held_without
    assert held >= 0.83 * cases, held
