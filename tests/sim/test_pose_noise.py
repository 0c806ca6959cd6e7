"""The noise of poses: its size, and whether it was smoothed."""

import numpy as np
import pytest

from sim.inference.pose_noise import PoseNoise, pose_noise
from sim2real.body import observed

PERIOD = 0.02
SD = np.array([0.002, 0.003, 0.01])


def filmed(lag, seed=0, samples=1000):
    """A robot that swims and turns, filmed with noise, and smoothed by the catalogue's filter."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(samples)
    beat = 2 * np.pi * 1.2 * t
    swims = np.stack([0.2 * t, 0.02 * np.sin(beat), 0.3 * np.sin(beat + 0.4)], axis=1)
    shaken = swims + SD * rng.standard_normal(swims.shape)
    return observed(t, shaken, {"pose_filter.time_constant_s": lag})


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_is_as_large_as_it_is_and_no_filter(seed):
    found = pose_noise(filmed(0.0, seed), PERIOD)
    assert found.lag_s == 0.0
    np.testing.assert_allclose(found.sd, SD, rtol=0.12)
    assert found.log_ratio(0.03) < -10


@pytest.mark.parametrize("lag", [0.03, 0.06, 0.12])
def test_a_filter_shows_in_the_noise(lag):
    found = pose_noise(filmed(lag), PERIOD)
    assert found.log_ratio(lag) > 15
    assert found.lag_s > 0.01
    assert found.log_ratio(0.0) == 0.0


def test_noise_is_drawn_as_it_was_found():
    drawn = PoseNoise(SD, 0.03).drawn(np.random.default_rng(0), (4000,), PERIOD)
    kept = np.exp(-PERIOD / 0.03)
    np.testing.assert_allclose(drawn.std(axis=0), SD * ((1 - kept) / (1 + kept)) ** 0.5, rtol=0.06)
    assert pose_noise(drawn, PERIOD).lag_s == pytest.approx(0.03, rel=0.4)


def test_short_films_say_nothing():
    assert pose_noise(filmed(0.0, samples=60), PERIOD) is None
