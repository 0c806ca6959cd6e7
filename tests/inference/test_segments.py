"""Segments that differ are found where they are, apart where they are, and seldom in noise."""

import numpy as np
import pytest

from sim2real.inference.segments import SHORTEST_S, inside, robust_sd, windows

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
        assert all(b - a >= SHORTEST_S for a, b in found)


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
