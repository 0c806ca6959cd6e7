import numpy as np
import pytest

from sim2real.ranges.latency import spread


@pytest.mark.parametrize("error", [1e-4, 5e-3])
def test_errors_are_not_counted_as_spread(error):
    """Over many sets, neither the half-width nor the centre is off on average."""
    half, centre = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        latencies = rng.uniform(0.048, 0.088, 40) + error * rng.standard_normal(40)
        estimate = spread(latencies, np.full(40, error))
        half.append(estimate.half_width)
        centre.append(estimate.centre)
    assert np.mean(half) == pytest.approx(0.020, rel=0.03)
    assert np.mean(centre) == pytest.approx(0.068, rel=0.01)


def test_its_interval_holds_the_truth_as_often_as_it_says():
    inside = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        latencies = rng.uniform(0.048, 0.088, 12) + 5e-4 * rng.standard_normal(12)
        low, high = spread(latencies, np.full(12, 5e-4)).half_width_90
        inside += low <= 0.020 <= high
    assert 83 <= inside <= 97


def test_equal_latencies_have_no_spread():
    rng = np.random.default_rng(0)
    estimate = spread(0.06 + 1e-3 * rng.standard_normal(30), np.full(30, 1e-3))
    assert estimate.half_width < 1e-3 and estimate.centre == pytest.approx(0.06, abs=5e-4)


def test_one_latency_leaves_the_spread_open():
    estimate = spread(np.array([0.06]), np.array([1e-3]))
    assert estimate.centre == pytest.approx(0.06, abs=1e-3)
    assert estimate.half_width_90[1] > 5 * estimate.half_width_90[0]
