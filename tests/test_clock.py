import numpy as np
import pytest
from good_input import message

from sim2real.clock import (
    Timing,
    check_sampling,
    clock_findings,
    missing_samples,
    recording_clock_findings,
    timing,
)

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
    assert list(clock_findings(T)) == []


ODD = [
    (np.where(T < 4, T, T + 0.42), "A gap of 0.44 s, starting at 3.98 s."),
    (bunched(), "of arrival, in bunches"),
    (np.cumsum(0.02 * np.where(np.arange(T.size) % 2, 0.6, 1.4)), "far from constant"),
]


@pytest.mark.parametrize(
    ("t", "words"),
    [
        *ODD,
        (np.where(T < 4, T, T + 0.4) + np.where(T < 6, 0, 0.2), "2 gaps, the longest of 0.42 s"),
        (np.where(np.arange(T.size) == 70, T - 0.0199, T), "Once a sample has almost the time"),
        (np.where(T < 5, T, 5 + 0.8 * (T - 5)), "changes from 50 to 62.5 Hz"),
        (5 * T, "At 10 Hz a servo's latency"),
    ],
)
def test_an_odd_clock(t: np.ndarray, words: str) -> None:
    assert words in " ".join(clock_findings(t))


@pytest.mark.parametrize("jitter_s", [1e-4, 1e-3])
def test_jitter_and_gaps_are_told_apart(jitter_s: float) -> None:
    rng = np.random.default_rng(0)
    t = np.where(T < 4, T, T + 0.42) + np.cumsum(rng.normal(0, jitter_s, T.size))
    clock = measure(t)
    assert clock.jitter_s == pytest.approx(jitter_s, rel=0.1)
    assert clock.gaps == (pytest.approx((t[199], t[200] - t[199])),)


def merged(measured: np.ndarray, sent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One time axis of measurements and set-points, and positions in the rows of the former."""
    t = np.union1d(measured, sent)
    return t, np.where(np.isin(t, measured), 0.1, np.nan)[:, None]


SENT = np.arange(0.0031, 10, 1 / 60)
"""Set-points at another rate: their rows come at any time between two measurements."""


@pytest.mark.parametrize("sent", [SENT, T + 5e-6, np.arange(0, 10, 0.01), np.arange(0.5, 10, 1.7)])
def test_rows_of_set_points_are_no_measurements(sent: np.ndarray) -> None:
    t, position = merged(T, sent)
    clock = timing(t, position)
    assert clock.rate_hz == pytest.approx(50)
    assert clock.jitter_s == pytest.approx(0, abs=1e-9)
    assert (clock.gaps, clock.missing_cells) == ((), 0)
    assert recording_clock_findings(["j1"], t, position) == []


IRREGULAR = np.cumsum(np.random.default_rng(0).gamma(2, 0.01, T.size))


@pytest.mark.parametrize(("measured", "words"), [*ODD, (IRREGULAR, "of arrival, in bunches")])
def test_measurements_at_odd_times_among_set_points(measured: np.ndarray, words: str) -> None:
    t, position = merged(measured, SENT)
    said = " ".join(f.text for f in recording_clock_findings(["j1"], t, position))
    assert words in said
    assert "missing one at a time" not in said


def test_joints_that_are_read_in_turn() -> None:
    """Each joint has an even clock, and a row of its own."""
    t = np.sort(np.concatenate([T, T + 0.004]))
    position = np.full((t.size, 2), np.nan)
    position[::2, 0], position[1::2, 1] = 0.1, 0.2
    assert recording_clock_findings(["a", "b"], t, position) == []
    position[200:240, 1] = np.nan
    (finding,) = recording_clock_findings(["a", "b"], t, position)
    assert finding.text == "b: A gap of 0.42 s, starting at 1.984 s."
    assert [missing_samples(t, angle) for angle in position.T] == [0, 20]


def test_missing_samples_are_no_jitter_and_dropped_rows_are_named() -> None:
    rng = np.random.default_rng(0)
    lost = rng.random(T.size) < 0.08
    lost[[0, 1, -1]] = False
    lost[1:] &= ~lost[:-1]  # one at a time
    position = np.where(lost, np.nan, 0.1)[:, None]
    clock = timing(T, position)
    assert clock.jitter_s == pytest.approx(0, abs=1e-9)
    assert (clock.gaps, clock.missing_cells) == ((), lost.sum())
    assert recording_clock_findings(["j1"], T, position) == []
    (finding,) = recording_clock_findings(["j1"], T[~lost], position[~lost])
    assert finding.severity == "warning"
    assert finding.text.startswith(f"{lost.sum()} samples are missing one at a time (")


def test_pauses_longer_than_the_rest_are_refused() -> None:
    """Servos are simulated through them, in more and more time and memory."""
    long = np.where(T < 4, T, T + 1e6)
    words = ("1e+06 s without samples", "after 3.98 s", "at most 30 s")
    message(lambda: check_sampling("log.csv", long), "log.csv: t_s", *words)
    many = T + 60 * (np.arange(T.size) // 10)
    message(lambda: check_sampling("log.csv", many), "without samples", "at most 30 s")
    check_sampling("log.csv", np.where(T < 4, T, T + 29))
    check_sampling("commands.csv", np.where(T < 4, T, T + 500), longest_s=10.0)
    hour = np.arange(0.0, 600.0, 0.02)
    check_sampling("log.csv", np.where(hour < 4, hour, hour + 599))
