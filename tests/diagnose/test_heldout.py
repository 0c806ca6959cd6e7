"""Errors on data that a fit has not seen: what is held out never touches what is fitted."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import KD, KP, LATENCY, NOISE, traced

from sim2real.diagnose.servo_search import baselines
from sim2real.identification.held_out import FOLDS, folds, held_out
from sim2real.servo.batch import Batch


@pytest.fixture(scope="module")
def three():
    return [traced(seed, name) for seed, name in enumerate("abc")]


@pytest.fixture(scope="module")
def start(three):
    return baselines(Batch([three])).servos


def spoiled(trace, where):
    rng = np.random.default_rng(9)
    return replace(trace, position=trace.position + where * rng.normal(0, 0.1, trace.t.size))


@pytest.mark.parametrize("count", [1, 3])
def test_each_fold_scores_segments_that_it_does_not_fit(three, count):
    pairs = folds(three[:count])
    assert len(pairs) == FOLDS
    for fitted, scored in pairs:
        for whole, one, other in zip(three, fitted, scored, strict=False):
            assert not (one.used & other.used).any()
            np.testing.assert_array_equal(one.used | other.used, whole.used)
            assert other.used.mean() == pytest.approx(1 / FOLDS, abs=0.01)
    np.testing.assert_array_equal(
        sum(scored[0].used.astype(int) for _, scored in pairs), three[0].used
    )


@pytest.mark.parametrize("count", [1, 3])
def test_parameters_never_see_what_they_are_scored_on(three, start, count):
    _, scored = folds(three[:count])[0]
    other = [spoiled(t, part.used) for t, part in zip(three, scored, strict=False)]
    (clean,), (dirty,) = (held_out([x], [start]) for x in (three[:count], other))
    np.testing.assert_array_equal(clean.theta[0], dirty.theta[0])
    assert np.std(dirty.residuals[0]) > 0.05, "it is scored there"
    assert np.abs(clean.theta[1:] - dirty.theta[1:]).max() > 1e-6, "the other folds do see it"


def test_the_right_servo_leaves_noise(three, start):
    (found,) = held_out([three], [start])
    assert found.rmse == pytest.approx(NOISE, rel=0.05)
    truth = np.tile([KP, KD, LATENCY], (FOLDS, 1))
    np.testing.assert_allclose(found.theta[:, :3], truth, rtol=0.03)
    assert sum(x.size for x in found.residuals) == sum(x.used.sum() for x in three)


def test_nothing_to_hold_out(three, start):
    """The command moves at the very end only."""
    trace = three[0]
    late = trace.t >= 11.9
    lone = replace(trace, command=0.3 * late, position=0.0 * late)
    assert held_out([[lone]], [start]) == [None]


def test_errors_are_relative_to_the_noise_of_each_reading(three, start):
    spread = np.where(three[0].t > 6, 10.0, 1.0)
    rng = np.random.default_rng(4)
    noisy = [
        replace(
            t, spread=spread, position=t.position + (spread - 1) * rng.normal(0, NOISE, spread.size)
        )
        for t in three
    ]
    (found,) = held_out([noisy], [start])
    assert found.rmse > 5 * NOISE
    assert found.error == pytest.approx(NOISE, rel=0.1)


def test_missing_samples_are_not_scored(three, start):
    used = np.arange(three[0].t.size) % 10 != 0
    gappy = replace(three[0], used=used, position=np.where(used, three[0].position, np.nan))
    (found,) = held_out([[gappy, *three[1:]]], [start])
    assert sum(x.size for x in found.residuals) == used.sum() + sum(t.used.sum() for t in three[1:])
    assert np.isfinite(found.rmse)
