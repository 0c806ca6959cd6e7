"""Samples that count, whitening, autocorrelation times, the wander of a sensor."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter

from sim2real.inference.correlated_noise import (
    Wander,
    autocorrelation_times,
    autoregression,
    correlation_samples,
    counting,
    lag_products,
    lags,
    long_run,
    whitened,
    whiteness,
)
from sim2real.inference.segments import inside, robust_sd, windows


def ar1(rng, rho, n):
    return lfilter([1.0], [1.0, -rho], rng.standard_normal(n))


def test_long_run_is_the_sum_of_weighted_lags():
    score = np.random.default_rng(0).standard_normal((60, 3))
    lags = 7
    expected = score.T @ score
    for k in range(1, lags):
        product = score[k:].T @ score[:-k]
        expected += (1 - k / lags) * (product + product.T)
    np.testing.assert_allclose(long_run(score, lags), expected, rtol=1e-12, atol=1e-12)


def test_whiteness():
    rng = np.random.default_rng(0)
    assert abs(whiteness([rng.standard_normal(5000)])) < 0.05
    assert whiteness([ar1(rng, 0.9, 5000)]) == pytest.approx(0.9, abs=0.03)
    assert whiteness([np.zeros(10)]) == 0.0


def test_samples_count_with_those_before_them():
    used = np.random.default_rng(0).random(200) > 0.05
    for order in (1, 4, 25):
        expected = [k >= order and used[k - order : k + 1].all() for k in range(used.size)]
        np.testing.assert_array_equal(counting(used, order), expected)


def test_an_autoregression_is_found_and_whitens():
    rng = np.random.default_rng(1)
    true = np.array([0.9, -0.3])
    series = lfilter([1.0], [1.0, -0.9, 0.3], rng.standard_normal(40000))
    counts = counting(np.ones(series.size, dtype=bool), 4)
    found = autoregression(lag_products(series, counts, 4)[None])[0]
    np.testing.assert_allclose(found, [*true, 0, 0], atol=0.02)
    assert abs(whiteness([whitened(series, found)[4:]])) < 0.01
    assert correlation_samples(whitened(series, found)) == pytest.approx(1.0, abs=0.1)


def test_a_constant_is_no_noise():
    """With a bound the whitening filter keeps some gain at frequency 0, and still fits best."""
    series = 5 + np.random.default_rng(2).standard_normal(5000)
    products = lag_products(series, counting(np.ones(5000, dtype=bool), 6), 6)[None]
    bounded, free = autoregression(products, 0.5)[0], autoregression(products)[0]
    assert bounded.sum() == pytest.approx(0.5)
    assert free.sum() > 0.8
    energy = np.einsum("i,ij,j", v := np.append(-1, bounded), products[0], v)
    for k in range(5):  # no neighbour on the bound is better
        other = bounded + 0.01 * (np.eye(6)[k] - np.eye(6)[k + 1])
        assert np.einsum("i,ij,j", w := np.append(-1, other), products[0], w) > energy


def test_the_wanders_filter_is_that_of_its_riccati_equation():
    wander = Wander(3.0, 1.5)
    top, bottom, spread = wander.filter(0.02)
    keep = np.exp(-0.02 / 3.0)
    (solved,) = solve_discrete_are(
        np.array([[keep]]), np.ones((1, 1)), np.array([[1.5**2 * (1 - keep**2)]]), np.ones((1, 1))
    ).ravel()
    assert spread == pytest.approx(solved, rel=1e-9)
    rng = np.random.default_rng(0)
    slow = lfilter([1.5 * np.sqrt(1 - keep**2)], [1.0, -keep], rng.standard_normal(100000))
    left = lfilter(top, bottom, slow + rng.standard_normal(slow.size))
    assert abs(whiteness([left])) < 0.01
    assert left.var() == pytest.approx(1 + spread, rel=0.02)


def test_the_memory_is_half_a_second_within_reason():
    assert [lags(x) for x in (0.02, 0.05, 0.5, 0.001)] == [25, 10, 4, 25]


@pytest.mark.parametrize("shape", [(9,), (64,), (700,), (200, 3, 2)])
def test_autocorrelation_times_are_those_of_emcee(shape):
    from emcee.autocorr import integrated_time

    series = np.cumsum(np.random.default_rng(1).standard_normal(shape), axis=0)
    expected = np.maximum(integrated_time(series, c=5.0, quiet=True, tol=0), 1.0)
    np.testing.assert_allclose(autocorrelation_times(series), expected, rtol=1e-12)


SD = 0.0015
T = 0.02 * np.arange(750)


def noise(seed=0, size=T.size):
    return np.random.default_rng(seed).normal(0, SD, size)


def with_events(*events, seed=0):
    """Noise, ten times as large in these segments."""
    return noise(seed) * np.where(inside(T, events), 10.0, 1.0)


@pytest.mark.parametrize("events", [((4.0, 5.0),), ((0.0, 0.6), (9.0, 10.5)), ((14.0, 14.98),)])
def test_events_are_found_where_they_are(events):
    found = windows(T, with_events(*events), SD)
    assert len(found) == len(events)
    np.testing.assert_allclose(found, events, atol=0.15)


def test_two_events_close_together_stay_two():
    events = ((4.0, 4.6), (5.4, 6.0))
    for seed in range(5):
        found = windows(T, with_events(*events, seed=seed), SD)
        assert len(found) == 2
        np.testing.assert_allclose(found, events, atol=0.15)


def test_one_event_with_a_quiet_sample_stays_one():
    residual = with_events((4.0, 6.0))
    residual[[225, 240, 241, 270]] = 0.0
    assert len(windows(T, residual, SD)) == 1


def test_noise_rarely_has_any():
    assert sum(bool(windows(T, noise(seed), SD)) for seed in range(200)) <= 2


def test_a_lone_outlier_is_no_window():
    residual = noise()
    residual[300] = 50 * SD
    assert windows(T, residual, SD) == ()


def test_missing_samples_neither_make_nor_break_a_window():
    residual = with_events((4.0, 6.0))
    residual[240:250] = np.nan
    (found,) = windows(T, residual, SD)
    np.testing.assert_allclose(found, (4.0, 6.0), atol=0.15)
    assert windows(T, np.full(T.size, np.nan), SD) == ()


def test_windows_are_in_order_and_no_shorter_than_they_may_be():
    rng = np.random.default_rng(0)
    edges = np.sort(rng.uniform(0, 15, (20, 6)), axis=1).reshape(20, 3, 2)
    for seed, events in enumerate(edges):
        found = windows(T, with_events(*map(tuple, events), seed=seed), SD)
        flat = np.ravel(found)
        assert (np.diff(flat) > 0).all()
        assert all(b - a >= 0.1 for a, b in found)


def test_inside_includes_both_ends():
    mask = inside(np.arange(6.0), ((1.0, 2.0), (4.0, 4.5)))
    np.testing.assert_array_equal(mask, [False, True, True, False, True, False])


def test_spread_is_that_outside_windows():
    events = ((4.0, 10.0),)
    residual = with_events(*events)
    residual[::50] = np.nan
    assert robust_sd(residual, inside(T, events)) == pytest.approx(SD, rel=0.12)
    everywhere = np.ones(T.size, dtype=bool)
    assert robust_sd(residual, everywhere) > 1.5 * SD, "all of it where nothing is outside"
