"""The statistics: long-run covariance, correlation time, robust scale, interval coverage."""

import numpy as np
import pytest

from sim2real.servo.fit import robust_scale
from sim2real.servo.uncertainty import bandwidth, correlation_samples, long_run, whiteness


def ar1(rng, rho, n):
    x = rng.standard_normal(n)
    for k in range(1, n):
        x[k] += rho * x[k - 1]
    return x


def test_white_residuals_have_correlation_time_one():
    times = [correlation_samples(np.random.default_rng(s).standard_normal(2000)) for s in range(20)]
    assert np.mean(times) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("rho", [0.5, 0.9])
def test_correlation_time_of_an_autoregression(rho):
    times = [correlation_samples(ar1(np.random.default_rng(s), rho, 20000)) for s in range(10)]
    assert np.mean(times) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)


def test_long_run_variance_of_an_autoregression():
    x = ar1(np.random.default_rng(0), 0.8, 50000)[:, None]
    lags = bandwidth(x.shape[0], 9.0) * 4
    assert long_run(x, lags)[0, 0] / x.shape[0] == pytest.approx(1 / (1 - 0.8) ** 2, rel=0.15)


def test_long_run_is_the_sum_of_weighted_lags():
    score = np.random.default_rng(0).standard_normal((60, 3))
    lags = 7
    expected = score.T @ score
    for k in range(1, lags):
        product = score[k:].T @ score[:-k]
        expected += (1 - k / lags) * (product + product.T)
    np.testing.assert_allclose(long_run(score, lags), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("wild", [0.0, 0.05])
def test_robust_scale_ignores_a_few_wild_samples(wild):
    rng = np.random.default_rng(0)
    error = 0.002 * rng.standard_normal(20000)
    error[: int(wild * error.size)] = 1.0
    assert robust_scale(error) == pytest.approx(0.002, rel=0.02 if wild == 0 else 0.4)


def test_whiteness():
    rng = np.random.default_rng(0)
    assert abs(whiteness([rng.standard_normal(5000)])) < 0.05
    assert whiteness([ar1(rng, 0.9, 5000)]) == pytest.approx(0.9, abs=0.03)
    assert whiteness([np.zeros(10)]) == 0.0


def test_intervals_hold_where_residuals_are_correlated():
    """A line through correlated noise: intervals for independent noise would miss half the time."""
    from scipy.stats import binomtest

    from sim2real.servo.fit import Fit
    from sim2real.servo.uncertainty import uncertainty

    held = 0
    x = np.linspace(-1, 1, 1500)
    slopes = np.stack([np.ones_like(x), x], axis=1)
    for seed in range(200):
        noise = ar1(np.random.default_rng(seed), 0.9, x.size)
        estimate = np.linalg.lstsq(slopes, noise, rcond=None)[0]
        error = slopes @ estimate - noise
        fit = Fit(
            names=("level", "slope"), parameters=estimate, low=np.full(2, -9.0),
            high=np.full(2, 9.0), free=(0, 1), scale_rad=robust_scale(error), residuals=(error,),
            jacobians=(slopes,), converged=True, inertia=1.0,
        )  # fmt: skip
        spread = uncertainty(fit, np.full(2, 100.0))
        held += abs(estimate[1]) < spread.half_width[1]
    low, high = binomtest(held, 200).proportion_ci(0.99)
    assert high > 0.85, held
    assert low < 0.97, held
