"""Intervals of a fit whose residuals are correlated in time or repeat with the angle."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binomtest

from sim2real.identification.problem import Fit, ServoProblem, plain_row
from sim2real.identification.repeating_error import variance_components
from sim2real.identification.uncertainty import uncertainty
from sim2real.inference.least_squares import robust_scale
from sim2real.inference.parameters import Parameter
from sim2real.recording import Load
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.trace import Trace

UNIT = 100.0
FREE = tuple(Parameter(name, -9.0, 9.0, UNIT) for name in COLUMNS[:2])


def linear_fit(t, angle, slopes, measured):
    """A least-squares fit of two coefficients of ``slopes``, and these."""
    estimate = np.linalg.lstsq(slopes, measured, rcond=None)[0]
    error = slopes @ estimate - measured
    trace = Trace("a", "a", t, angle, angle - error, Load(0.002), np.ones(t.size, bool))
    problem = ServoProblem([trace], plain_row(4.0, 0.1, 0.0), FREE)
    none = np.empty((0, 2)), np.empty(0)
    x, scale = np.array([4.0, 0.1]) / UNIT, robust_scale(error)
    return Fit(problem, x, error, slopes * UNIT, scale, 1.0, True, *none), estimate


def half_width(fit, repeating):
    return uncertainty(fit, repeating=repeating).half_width * UNIT


def test_intervals_hold_where_residuals_are_correlated():
    """A line through correlated noise: intervals for independent noise would miss half the time."""
    held = 0
    x = np.linspace(-1, 1, 1500)
    slopes = np.stack([np.ones_like(x), x], axis=1)
    for seed in range(200):
        white = np.random.default_rng(seed).standard_normal(x.size)
        noise = lfilter([1.0], [1.0, -0.9], white)
        fit, estimate = linear_fit(np.arange(x.size) / 50, x, slopes, noise)
        held += abs(estimate[1]) < half_width(fit, False)[1]
    low, high = binomtest(held, 200).proportion_ci(0.99)
    assert high > 0.85, held
    assert low < 0.97, held


def test_intervals_hold_where_errors_repeat_with_the_angle():
    """A servo that passes the same angles again and again, with an error that depends on them."""
    t = np.arange(1000) / 50
    angle = 0.5 * np.sin(2 * np.pi * 0.5 * t)
    slopes = np.stack([angle, np.gradient(angle, t)], axis=1)
    held, held_without, cases = 0, 0, 60
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        cycles, phase = rng.uniform(0.5, 10.0, 3), rng.uniform(0, 2 * np.pi, 3)
        repeating = np.sin(2 * np.pi * np.outer(angle, cycles) + phase).sum(axis=1)
        measured = 3e-3 * repeating + 1e-3 * rng.standard_normal(t.size)
        fit, estimate = linear_fit(t, angle, slopes, measured)
        held += abs(estimate[0]) < half_width(fit, True)[0]
        held_without += abs(estimate[0]) < half_width(fit, False)[0]
    assert held_without < 0.5 * cases, held_without
    assert held >= 0.83 * cases, held


def test_variances_are_recovered_beside_noise_and_fitted_parameters():
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        slopes = rng.standard_normal((800, 2))
        groups = [rng.standard_normal((800, 30)) for _ in range(2)]
        of_group = (0.5, 2.0)
        error = rng.standard_normal(800) + slopes @ [3.0, -2.0]
        for sd, group in zip(of_group, groups, strict=True):
            error += group @ (sd * rng.standard_normal(30))
        squares, freedom = variance_components(error, slopes, np.zeros((2, 2)), groups)
        found.append([square.mean() for square in squares])
        assert np.all((freedom > 25) & (freedom <= 30))
    assert np.mean(found, axis=0) == pytest.approx([0.25, 4.0], rel=0.15)


def test_a_single_wave_keeps_its_power_and_one_that_the_fit_absorbs_has_that_of_the_others():
    rng = np.random.default_rng(1)
    group = rng.standard_normal((800, 30))
    slopes = group[:, [5]]
    error = rng.standard_normal(800) + 2.0 * group[:, 7]
    (squares,), _ = variance_components(error, slopes, np.zeros((1, 1)), [group])
    others = np.delete(squares, [5, 7])
    assert squares[7] == pytest.approx(4.0, rel=0.15)
    assert squares[5] == pytest.approx(squares.mean(), rel=0.15)
    assert others.max() < 0.2 * squares[5]
