from __future__ import annotations

import numpy as np
import pytest

from sim2real.clock import Timing, check_sampling, clock_findings, timing

T = np.arange(0, 10, 0.02)


def measure(t: np.ndarray, missing: int = 0) -> Timing:
    position = np.zeros((t.size, 2))
    position[:missing, 1] = np.nan
    return timing(t, position)


def bunched() -> np.ndarray:
    """Every tenth sample is stamped a tenth of a step after the one before it."""
    late = T.copy()
    late[1::10] = T[0::10] + 0.002
    return late


def test_an_even_clock() -> None:
    clock = measure(T, missing=7)
    assert clock.rate_hz == pytest.approx(50)
    assert clock.jitter_s == pytest.approx(0, abs=1e-9)
    assert (clock.gaps, clock.missing_cells) == ((), 7)
    assert list(clock_findings(T, clock)) == []


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (np.where(T < 4, T, T + 0.42), "A gap of 0.44 s, starting at 3.98 s."),
        (np.where(T < 4, T, T + 0.4) + np.where(T < 6, 0, 0.2), "2 gaps, the longest of 0.42 s"),
        (bunched(), "of arrival, in bunches"),
        (np.where(np.arange(T.size) == 70, T - 0.0199, T), "Once a sample has almost the time"),
        (np.cumsum(0.02 * np.where(np.arange(T.size) % 2, 0.6, 1.4)), "far from constant"),
        (np.where(T < 5, T, 5 + 0.8 * (T - 5)), "changes from 50 to 62.5 Hz"),
        (5 * T, "At 10 Hz a servo's latency"),
    ],
)
def test_an_odd_clock(t: np.ndarray, words: str) -> None:
    assert words in " ".join(clock_findings(t, measure(t)))


def test_a_set_point_and_an_angle_may_have_rows_of_their_own() -> None:
    check_sampling("log.csv", np.sort(np.concatenate([T, T + 5e-6])))


@pytest.mark.parametrize("jitter_s", [1e-4, 1e-3])
def test_jitter_and_gaps_are_told_apart(jitter_s: float) -> None:
    rng = np.random.default_rng(0)
    t = np.where(T < 4, T, T + 0.42) + np.cumsum(rng.normal(0, jitter_s, T.size))
    clock = measure(t)
    assert clock.jitter_s == pytest.approx(jitter_s, rel=0.1)
    assert clock.gaps == (pytest.approx((t[199], t[200] - t[199])),)
